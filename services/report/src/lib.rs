//! Reports and pictures: plain data in, one self-contained file out.
//!
//! - [`identification_report`], [`payload_report`] and [`diagnosis_report`] write HTML that opens offline, in light and dark,
//!   on paper and by keyboard, in less than [`MAX_BYTES`] bytes. Their input are the plain structs of this
//!   crate; it knows nothing of how the numbers came about.
//! - [`Report`] is the general form, made of [`Block`]s, for any other report.
//! - [`overlay_svg`] and [`table_picture`] draw static pictures for documents.
//!
//! **Safety of the output.** Joint and file names are somebody else's input. Every string is escaped, and
//! the file's content security policy forbids every request and every script but the two inlined ones.
//!
//! **Determinism.** The same data give the same bytes: no clock, no random ids, no hash order.

mod blocks;
mod chart;
mod common;
mod data;
mod decimate;
mod diagnosis;
mod escape;
mod heat;
mod html;
mod identification;
pub mod number;
mod payload;
mod picture;

pub use blocks::{Bar, Bars, Block, Cell, Figure, HeatMap, Report, Section, Table, Tone};
pub use chart::{Axis, Chart, Cloud, Curve, Role};
pub use data::{JointTrace, NamedSeries, ParameterRow, RepairRow, Setup, Stretch, TorqueTrace};
pub use diagnosis::{
    BeforeAfterRow, DiagnosisReportData, Excluded, Finding, ForwardRow, Gain, Located, NextExperiment, Region,
    TimeInterval, Unknown, diagnosis_report,
};
pub use html::MAX_BYTES;
pub use identification::{
    ConditionRow, ErrorTable, ForwardErrors, HeldOutRow, IdentificationReportData, MethodRow, NotExcited,
    identification_report,
};
pub use payload::{PayloadReportData, PayloadRow, PayloadTrace, payload_report};
pub use picture::{OverlayPicture, overlay_svg, table_picture};
