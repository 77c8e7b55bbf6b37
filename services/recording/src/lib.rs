//! Everything of Lacuna that touches file formats: reading recordings, writing them as MCAP, and loading the
//! files a user writes.
//!
//! - [`open`] and [`read_all`] read any format of the registry in [`formats`]; all formats pass the same
//!   judgement ([`condition`]): what cannot be used is an error with its place, what is repaired is counted.
//! - [`load_robot`], [`load_model`], [`load_graph`] read the TOML files.
//!
//! Libraries stay free of clocks and of the bus: nothing here knows a process or a topic of shared memory.

pub mod condition;
pub mod files;
pub mod formats;
mod reader;
mod sample;

pub use files::{LoadedRobot, load_graph, load_model, load_robot};
pub use reader::{EPOCH_FROM_S, MAX_VALUES, ReadOptions, Reader, TimeSource, open, open_with, read_all, read_all_with};
pub use sample::{About, RawReader, Sample};
