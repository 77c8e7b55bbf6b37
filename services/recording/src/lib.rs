//! Everything of Lacuna that touches file formats: reading recordings, writing them as MCAP, and loading the
//! files a user writes.
//!
//! - [`open`] and [`read_all`] read any format of the registry in [`formats`]; all formats pass the same
//!   judgement ([`condition`]): what cannot be used is an error with its place, what is repaired is counted.
//! - [`container::Writer`] and [`topics`] write MCAP that ROS 2 tools and viewers open as it is, and that a
//!   crash cuts at most half a second short; [`recover`] completes what a crash left.
//! - [`messages::Messages`] hands out an MCAP's messages as they stand in it, decoded by their own definitions.
//! - [`load_robot`], [`load_model`], [`load_graph`] read the TOML files.
//!
//! Nothing here knows the bus.

pub mod condition;
pub mod container;
pub mod ethercat;
pub mod files;
pub mod formats;
pub mod messages;
mod reader;
pub mod ros;
mod sample;
pub mod survey;
pub mod topics;

pub use container::{FileInfo, Recovered, inspect, recover};
pub use files::{LoadedRobot, load_graph, load_model, load_robot};
pub use reader::{
    EPOCH_FROM_S, MAX_VALUES, ReadOptions, Reader, TimeSource, file_of, is_mcap, open, open_with, read_all,
    read_all_with,
};
pub use sample::{About, RawReader, Sample};
pub use survey::{Survey, Table, survey};
