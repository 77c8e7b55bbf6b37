//! The registry of log formats: one file and one line each.

mod capture;
mod csv;
mod mcap;
pub(crate) mod packets;
pub(crate) mod rows;

use crate::ReadOptions;
use crate::sample::RawReader;
use lacuna_interfaces::{BadInput, RobotFile};
use std::path::Path;

/// What a format needs to open a recording.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// The file.
    pub path: &'a Path,
    /// The robot whose joints are wanted.
    pub robot: &'a RobotFile,
    /// The user's choices.
    pub options: &'a ReadOptions,
}

/// A log format.
#[derive(Debug)]
pub struct Format {
    /// Name in messages.
    pub name: &'static str,
    /// File name extensions, lower case, without the dot.
    pub extensions: &'static [&'static str],
    /// Whether numbers come back as they were written; a capture holds counts.
    pub exact: bool,
    /// Recognises a file by its first bytes, if the format has a signature.
    pub sniff: Option<fn(&[u8]) -> bool>,
    /// Opens a recording.
    pub open: fn(&Request<'_>) -> Result<Box<dyn RawReader>, BadInput>,
}

/// All formats. To add one: write its file, add its line, and run the conformance suite
/// (`tests/conformance.rs`) over it.
pub const FORMATS: &[Format] = &[mcap::FORMAT, csv::FORMAT, capture::FORMAT];

/// Longest signature a format may look at [bytes].
pub const SNIFF_BYTES: usize = 16;

/// The format of a file: by its first bytes if they are a known signature, else by its name.
///
/// # Errors
/// [`BadInput`] listing the known formats.
pub fn detect(path: &Path, first_bytes: &[u8]) -> Result<&'static Format, BadInput> {
    if let Some(format) = FORMATS.iter().find(|f| f.sniff.is_some_and(|sniff| sniff(first_bytes))) {
        return Ok(format);
    }
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let known: Vec<String> = FORMATS.iter().flat_map(|f| f.extensions).map(|e| format!(".{e}")).collect();
    let by_name = FORMATS.iter().find(|f| f.extensions.contains(&extension.as_str()));
    // A signature outranks the name: an .mcap without one is not an MCAP file, whatever it is called.
    match by_name {
        Some(format) if format.sniff.is_none() => Ok(format),
        Some(format) => {
            let what = format!("found no {} signature in the first bytes; expected what the name says", format.name);
            Err(BadInput::new(what).in_file(path))
        }
        None => {
            let found = if first_bytes.starts_with(b"#ROSBAG") {
                "a ROS 1 bag".to_owned()
            } else if extension.is_empty() {
                "a file of unknown format".to_owned()
            } else {
                format!("a .{extension} file")
            };
            Err(BadInput::new(format!("found {found}; expected one of {}", known.join(", "))).in_file(path))
        }
    }
}
