//! CSV: a header line with the columns' names, then one line per row. `t_s` comes first, then the exact `stamp_ns`; an
//! empty cell is no value, a flag is `true` or `false`. Numbers are as short as they can be to read back the same.

use super::{Format, TableSink};
use crate::file::ExportError;
use crate::table::{Block, Kind, Table};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// The registry's line.
pub(crate) const FORMAT: Format = Format { name: "CSV", extension: "csv", create };

fn create(file: File, table: &Table, _folder: &Path) -> Result<Box<dyn TableSink>, ExportError> {
    let mut writer = csv::Writer::from_writer(BufWriter::new(file));
    let names = ["t_s", "stamp_ns"].into_iter().chain(table.columns.iter().map(|c| c.name.as_str()));
    writer.write_record(names).map_err(fail)?;
    Ok(Box::new(Csv { writer, table: table.clone(), cell: Vec::new() }))
}

struct Csv {
    writer: csv::Writer<BufWriter<File>>,
    table: Table,
    cell: Vec<u8>,
}

fn fail(e: csv::Error) -> ExportError {
    ExportError::write(e.into())
}

impl Csv {
    fn cell(&mut self, text: std::fmt::Arguments<'_>) -> Result<(), ExportError> {
        self.cell.clear();
        self.cell.write_fmt(text).map_err(ExportError::write)?;
        self.writer.write_field(&self.cell).map_err(fail)
    }
}

impl TableSink for Csv {
    fn block(&mut self, block: &Block) -> Result<(), ExportError> {
        let kinds: Vec<Kind> = self.table.columns.iter().map(|c| c.kind).collect();
        for (i, &stamp) in block.stamps_ns.iter().enumerate() {
            let t_s = self.table.t_s(stamp);
            self.cell(format_args!("{t_s}"))?;
            self.cell(format_args!("{stamp}"))?;
            for (values, kind) in block.values.iter().zip(&kinds) {
                let value = values.get(i).copied().unwrap_or(f64::NAN);
                match kind {
                    _ if value.is_nan() => self.cell(format_args!(""))?,
                    Kind::Flag => self.cell(format_args!("{}", value != 0.0))?,
                    Kind::Float | Kind::Integer => self.cell(format_args!("{value}"))?,
                }
            }
            // Ends the record.
            self.writer.write_record(None::<&[u8]>).map_err(fail)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<(), ExportError> {
        let buffer = self.writer.into_inner().map_err(|e| ExportError::write(e.into_error()))?;
        buffer.into_inner().map_err(|e| ExportError::write(e.into_error())).map(|_| ())
    }
}
