//! The registry of table formats: one file and one line each.

mod csv;
mod mat;
pub(crate) mod parquet;

use crate::file::ExportError;
use crate::table::{Block, Table};
use lacuna_interfaces::BadInput;
use std::fs::File;
use std::path::Path;

/// A table format.
pub struct Format {
    /// Name in messages.
    pub name: &'static str,
    /// File name extension, lower case, without the dot.
    pub extension: &'static str,
    /// Begins a file: the handle to write to, the table's columns, a folder for temporary files.
    pub(crate) create: Create,
}

pub(crate) type Create = fn(File, &Table, &Path) -> Result<Box<dyn TableSink>, ExportError>;

impl std::fmt::Debug for Format {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Format").field("name", &self.name).finish_non_exhaustive()
    }
}

/// All formats. To add one: write its file and add its line; the tests of `tests/tables.rs` run over every one.
pub const FORMATS: &[Format] = &[csv::FORMAT, parquet::FORMAT, mat::FORMAT];

impl Format {
    /// The format that the name of `path` asks for.
    ///
    /// # Errors
    /// [`BadInput`] that lists the formats.
    pub fn of(path: &Path) -> Result<&'static Self, BadInput> {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
        FORMATS.iter().find(|f| f.extension == extension).ok_or_else(|| {
            let known: Vec<String> = FORMATS.iter().map(|f| format!(".{}", f.extension)).collect();
            BadInput::new(format!(
                "found the ending \".{extension}\"; expected {}, or --bag for a folder",
                known.join(", ")
            ))
            .in_file(path)
        })
    }
}

/// Writes a table block by block.
pub(crate) trait TableSink {
    /// Appends rows.
    fn block(&mut self, block: &Block) -> Result<(), ExportError>;
    /// Completes the file.
    fn finish(self: Box<Self>) -> Result<(), ExportError>;
}
