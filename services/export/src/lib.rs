//! Recordings for other programs: one table, one row per sample, as CSV, Parquet or MATLAB file; or a ROS 2 bag folder.
//!
//! - [`export`] streams: beyond one block of rows and a window in which topics are joined, nothing is held in memory.
//! - [`formats`] is the registry: a format is one file and one line.
//! - [`bag`] puts a recording into the folder that `ros2 bag` opens.
//! - [`rows`] writes small Parquet tables of results that aggregate over many robots.
//!
//! A file is written under another name and renamed when it is complete, so nothing half-written is ever taken for it.

pub mod bag;
mod columns;
mod file;
pub mod formats;
mod join;
mod plan;
pub mod rows;
mod samples;
mod table;

pub use file::{ExportError, NewFile};
pub use table::{BLOCK_ROWS, Block, Column, Kind, Table};

use formats::Format;
use lacuna_interfaces::{BadInput, Repair, RobotFile};
use std::path::Path;

/// What is to be exported.
#[derive(Debug, Clone)]
pub struct Request<'a> {
    /// Recording: an MCAP file or bag folder, or with a robot file any recording that can be read.
    pub recording: &'a Path,
    /// Robot file: the recording's samples as every other command reads them (judged, repaired, joints matched by name);
    /// `None`: the messages of an MCAP as they stand in it.
    pub robot: Option<&'a RobotFile>,
    /// Topics; empty: all whose meaning is known (JointState and Lacuna's own). With a robot at most one.
    pub topics: &'a [String],
    /// Leave out what lies before this time after the first sample [s].
    pub from_s: f64,
    /// Stop at this time after the first sample [s]; infinite for the whole recording.
    pub to_s: f64,
    /// File to write; its extension chooses the format.
    pub to: &'a Path,
    /// Replace the file if it exists.
    pub force: bool,
}

/// What was exported.
#[derive(Debug, Clone, PartialEq)]
pub struct Exported {
    /// Name of the format.
    pub format: &'static str,
    /// Rows.
    pub rows: u64,
    /// The table's columns, time aside.
    pub table: Table,
    /// Size of the file [bytes].
    pub bytes: u64,
    /// Topics or columns that were left out, with their type.
    pub left_out: Vec<String>,
    /// Messages that came too late for their row and are missing in the table.
    pub late: u64,
    /// Messages with the stamp of another one of their topic, which they replaced.
    pub repeated: u64,
    /// What the reader repaired (with a robot file).
    pub repairs: Vec<Repair>,
    /// True if the recording stops before its proper end.
    pub was_cut: bool,
}

/// Rows on their way into a file.
pub(crate) trait RowSource {
    /// The table.
    fn table(&self) -> &Table;
    /// Overwrites `block` with up to [`BLOCK_ROWS`] rows; `false` when there is none left.
    fn next_block(&mut self, block: &mut Block) -> Result<bool, BadInput>;
    /// Share of the recording that has been read in this pass, 0 to 1.
    fn fraction(&self) -> f64;
    /// Fills in what is known at the end.
    fn account(&self, exported: &mut Exported);
}

/// Exports a recording as one table. `progress` hears the share done, 0 to 1.
///
/// # Errors
/// [`ExportError`] for an unknown format, an existing file, a recording that cannot be read or has nothing to export, or
/// a disk that does not take it.
pub fn export(request: &Request<'_>, progress: &mut dyn FnMut(f64)) -> Result<Exported, ExportError> {
    let format = Format::of(request.to)?;
    check_range(request)?;
    let new = NewFile::create(request.to, request.force)?;
    let mut source: Box<dyn RowSource> = match request.robot {
        Some(robot) => Box::new(samples::Samples::open(request, robot, progress)?),
        None => Box::new(join::Joined::open(request, progress)?),
    };
    let mut sink = (format.create)(new.file()?, source.table(), new.folder())?;
    let mut block = Block::new(source.table().columns.len());
    let mut rows = 0;
    while source.next_block(&mut block)? {
        rows += block.len() as u64;
        sink.block(&block).map_err(|e| e.in_file(request.to))?;
        progress(0.5 + 0.5 * source.fraction());
    }
    if rows == 0 {
        return Err(BadInput::new("found no sample in this time; expected at least one")
            .in_file(request.recording)
            .into());
    }
    sink.finish().map_err(|e| e.in_file(request.to))?;
    let bytes = new.commit()?;
    let mut exported = Exported {
        format: format.name,
        rows,
        table: source.table().clone(),
        bytes,
        left_out: Vec::new(),
        late: 0,
        repeated: 0,
        repairs: Vec::new(),
        was_cut: false,
    };
    source.account(&mut exported);
    Ok(exported)
}

fn check_range(request: &Request<'_>) -> Result<(), BadInput> {
    if !(request.from_s.is_finite() && request.from_s >= 0.0) {
        return Err(BadInput::new(format!("--from: found {}; expected zero or a positive number", request.from_s)));
    }
    // Infinity is the whole recording.
    if request.to_s.is_nan() || request.to_s <= request.from_s {
        return Err(BadInput::new(format!("--until: found {}; expected more than --from", request.to_s)));
    }
    Ok(())
}
