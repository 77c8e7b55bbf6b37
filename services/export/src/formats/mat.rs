//! MATLAB: a MAT-file of level 5 (`load` of every MATLAB since 5, Octave, `scipy.io.loadmat`).
//!
//! | variable | holds |
//! |---|---|
//! | `t_s`, `stamp_ns` | time [s] (double) and the exact stamp (int64), one row per sample |
//! | `measured_q_rad`, … | a group of columns: a matrix, one row per sample, one column per joint; NaN is no value |
//! | `joints.measured_q_rad` | its columns' joints, a cell array |
//! | `units.measured_q_rad` | its unit, in ASCII (`degC`, `rad/s^2`) |
//!
//! Layout: "MAT-File Format", The MathWorks, chapter 1 (level 5): a header of 128 bytes, then elements of a tag (type,
//! bytes) and data padded to 8 bytes; matrices lie column by column. A variable of level 5 holds less than 2^31 bytes.
//!
//! The crates for this format (`matfile`, `matrw`, `mat5`) want whole matrices in memory. Here rows come block by block:
//! they go to a temporary file, column by column within each block, and are put in order at the end.

use super::{Format, TableSink};
use crate::file::ExportError;
use crate::table::{Block, Table};
use lacuna_interfaces::BadInput;
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// The registry's line.
pub(crate) const FORMAT: Format = Format { name: "MATLAB", extension: "mat", create };

/// Longest name of a variable or field.
const MAX_NAME: usize = 63;

// Data types (table 1-1) and array classes (table 1-3) of the format.
const MI_INT8: u32 = 1;
const MI_UINT16: u32 = 4;
const MI_INT32: u32 = 5;
const MI_UINT32: u32 = 6;
const MI_DOUBLE: u32 = 9;
const MI_INT64: u32 = 12;
const MI_MATRIX: u32 = 14;
const CELL: u32 = 1;
const STRUCT: u32 = 2;
const CHAR: u32 = 4;
const DOUBLE: u32 = 6;
const INT64: u32 = 14;

fn create(file: File, table: &Table, folder: &Path) -> Result<Box<dyn TableSink>, ExportError> {
    let fail = |source| ExportError::Io { path: folder.to_path_buf(), action: "written", source };
    let spill = tempfile::tempfile_in(folder).map_err(fail)?;
    Ok(Box::new(Mat {
        out: BufWriter::new(file),
        spill: BufWriter::new(spill),
        table: table.clone(),
        blocks: Vec::new(),
    }))
}

struct Mat {
    out: BufWriter<File>,
    /// Blocks as they came: stamps, then column after column.
    spill: BufWriter<File>,
    table: Table,
    /// Rows of each block.
    blocks: Vec<usize>,
}

impl TableSink for Mat {
    fn block(&mut self, block: &Block) -> Result<(), ExportError> {
        for stamp in &block.stamps_ns {
            self.spill.write_all(&stamp.to_le_bytes()).map_err(ExportError::write)?;
        }
        for value in block.values.iter().flatten() {
            self.spill.write_all(&value.to_le_bytes()).map_err(ExportError::write)?;
        }
        self.blocks.push(block.len());
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<(), ExportError> {
        let Self { mut out, spill, table, blocks } = *self;
        let file = spill.into_inner().map_err(|e| ExportError::write(e.into_error()))?;
        let mut spill = Spill { file: BufReader::new(file), blocks, columns: table.columns.len() };
        let groups = groups(&table);
        let rows = spill.blocks.iter().sum::<usize>();
        for columns in groups.iter().map(|g| g.columns.len()).chain([1]) {
            if rows.saturating_mul(columns).saturating_mul(8) > i32::MAX as usize - 4096 {
                return Err(too_large(rows, columns).into());
            }
        }
        header(&mut out).map_err(ExportError::write)?;
        let mut write = || -> std::io::Result<()> {
            numbers(&mut out, "t_s", DOUBLE, rows, 1, |out| {
                spill.column(0, |bytes| out.write_all(&table.t_s(i64::from_le_bytes(bytes)).to_le_bytes()))
            })?;
            numbers(&mut out, "stamp_ns", INT64, rows, 1, |out| spill.column(0, |bytes| out.write_all(&bytes)))?;
            for group in &groups {
                numbers(&mut out, &group.name, DOUBLE, rows, group.columns.len(), |out| {
                    group.columns.iter().try_for_each(|c| spill.column(c + 1, |bytes| out.write_all(&bytes)))
                })?;
            }
            let fields = |value: &dyn Fn(&Group) -> Vec<u8>| -> Vec<(String, Vec<u8>)> {
                groups.iter().map(|g| (g.name.clone(), value(g))).collect()
            };
            out.write_all(&structure("joints", &fields(&|g| cells(&g.joints))))?;
            out.write_all(&structure("units", &fields(&|g| characters("", &g.unit))))?;
            out.flush()
        };
        write().map_err(ExportError::write)
    }
}

fn too_large(rows: usize, columns: usize) -> BadInput {
    BadInput::new(format!(
        "found a matrix of {rows} × {columns} numbers; expected less than 2 GiB, which is what this format can hold: \
         choose a part of the time, or .parquet"
    ))
}

/// The spilled blocks.
struct Spill {
    file: BufReader<File>,
    blocks: Vec<usize>,
    columns: usize,
}

impl Spill {
    /// Calls `take` for every row of a column; column 0 is the stamps.
    fn column(&mut self, column: usize, mut take: impl FnMut([u8; 8]) -> std::io::Result<()>) -> std::io::Result<()> {
        let mut at: u64 = 0;
        for &rows in &self.blocks {
            self.file.seek(SeekFrom::Start(at + 8 * (rows * column) as u64))?;
            for _ in 0..rows {
                let mut bytes = [0; 8];
                self.file.read_exact(&mut bytes)?;
                take(bytes)?;
            }
            at += 8 * (rows * (self.columns + 1)) as u64;
        }
        Ok(())
    }
}

/// Columns that become one matrix.
struct Group {
    name: String,
    columns: Vec<usize>,
    joints: Vec<String>,
    unit: String,
}

fn groups(table: &Table) -> Vec<Group> {
    let mut groups: Vec<(&str, &str, Group)> = Vec::new();
    for (i, column) in table.columns.iter().enumerate() {
        let key = (column.group.as_str(), column.topic.as_str());
        let joint = column.joint.clone().unwrap_or_default();
        // Details stand in a topic of their own but never share a group's name with it.
        match groups.iter_mut().find(|(group, topic, _)| (*group, *topic) == key) {
            Some((_, _, group)) => {
                group.columns.push(i);
                group.joints.push(joint);
            }
            None => {
                // MATLAB and SciPy disagree about characters beyond ASCII.
                let unit = column.unit.replace('°', "deg").replace('²', "^2");
                groups.push((key.0, key.1, Group { name: String::new(), columns: vec![i], joints: vec![joint], unit }));
            }
        }
    }
    let mut taken: Vec<String> = ["t_s", "stamp_ns", "joints", "units"].map(str::to_owned).to_vec();
    let named = groups.into_iter().map(|(name, _, mut group)| {
        group.name = variable(name, &taken);
        taken.push(group.name.clone());
        group
    });
    named.collect()
}

/// A name that MATLAB takes: letters, digits, underscores, a letter first, none of those `taken`.
fn variable(name: &str, taken: &[String]) -> String {
    let mut bare: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if !bare.starts_with(|c: char| c.is_ascii_alphabetic()) {
        bare.insert(0, 'x');
    }
    bare.truncate(MAX_NAME);
    let mut found = bare.clone();
    let mut n = 1;
    while taken.contains(&found) {
        n += 1;
        let ending = format!("_{n}");
        found = format!("{}{ending}", &bare[..bare.len().min(MAX_NAME - ending.len())]);
    }
    found
}

fn header(out: &mut impl Write) -> std::io::Result<()> {
    let mut header = [b' '; 128];
    let text = concat!("MATLAB 5.0 MAT-file, written by lacuna ", env!("CARGO_PKG_VERSION"));
    for (to, from) in header.iter_mut().zip(text.bytes().take(116)) {
        *to = from;
    }
    // No subsystem data; version 1.0; the mark by which a reader tells the byte order.
    let (end, rest): (&mut [u8], &[u8]) =
        (header.split_at_mut(116).1, &[0, 0, 0, 0, 0, 0, 0, 0, 0x00, 0x01, b'I', b'M']);
    end.copy_from_slice(rest);
    out.write_all(&header)
}

fn put_tag(out: &mut Vec<u8>, kind: u32, bytes: usize) {
    out.extend_from_slice(&kind.to_le_bytes());
    out.extend_from_slice(&(bytes as u32).to_le_bytes());
}

fn put_element(out: &mut Vec<u8>, kind: u32, data: &[u8]) {
    put_tag(out, kind, data.len());
    out.extend_from_slice(data);
    out.resize(out.len().next_multiple_of(8), 0);
}

/// The parts of an array before its data: flags with the class, dimensions, name.
fn put_array_head(out: &mut Vec<u8>, class: u32, rows: usize, columns: usize, name: &str) {
    put_element(out, MI_UINT32, &[class.to_le_bytes(), 0_u32.to_le_bytes()].concat());
    put_element(out, MI_INT32, &[(rows as i32).to_le_bytes(), (columns as i32).to_le_bytes()].concat());
    put_element(out, MI_INT8, name.as_bytes());
}

/// A matrix of numbers of 8 bytes, which `fill` writes column by column.
fn numbers<W: Write>(
    out: &mut W,
    name: &str,
    class: u32,
    rows: usize,
    columns: usize,
    fill: impl FnOnce(&mut W) -> std::io::Result<()>,
) -> std::io::Result<()> {
    let mut head = Vec::new();
    put_array_head(&mut head, class, rows, columns, name);
    let bytes = 8 * rows * columns;
    put_tag(&mut head, if class == INT64 { MI_INT64 } else { MI_DOUBLE }, bytes);
    let mut tag = Vec::new();
    put_tag(&mut tag, MI_MATRIX, head.len() + bytes);
    out.write_all(&tag)?;
    out.write_all(&head)?;
    fill(out)
}

/// An array that is built in memory.
fn array(class: u32, rows: usize, columns: usize, name: &str, fill: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut content = Vec::new();
    put_array_head(&mut content, class, rows, columns, name);
    fill(&mut content);
    let mut out = Vec::new();
    put_element(&mut out, MI_MATRIX, &content);
    out
}

fn characters(name: &str, text: &str) -> Vec<u8> {
    let units: Vec<u16> = text.encode_utf16().collect();
    array(CHAR, usize::from(!units.is_empty()), units.len(), name, |out| {
        let bytes: Vec<u8> = units.iter().flat_map(|u| u.to_le_bytes()).collect();
        put_element(out, MI_UINT16, &bytes);
    })
}

fn cells(texts: &[String]) -> Vec<u8> {
    array(CELL, 1, texts.len(), "", |out| texts.iter().for_each(|text| out.extend(characters("", text))))
}

fn structure(name: &str, fields: &[(String, Vec<u8>)]) -> Vec<u8> {
    const FIELD: usize = MAX_NAME + 1;
    array(STRUCT, 1, 1, name, |out| {
        // The length of the names is a small element: type and size share its first four bytes.
        out.extend_from_slice(&(MI_INT32 | 4 << 16).to_le_bytes());
        out.extend_from_slice(&(FIELD as u32).to_le_bytes());
        let mut names = Vec::new();
        for (field, _) in fields {
            let end = names.len() + FIELD;
            names.extend(field.bytes().take(MAX_NAME));
            names.resize(end, 0);
        }
        put_element(out, MI_INT8, &names);
        fields.iter().for_each(|(_, value)| out.extend_from_slice(value));
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_such_that_matlab_takes_them() {
        let taken = ["q_rad".to_owned()];
        assert_eq!(variable("q_rad", &taken), "q_rad_2");
        assert_eq!(variable("before/residual tau", &[]), "before_residual_tau");
        assert_eq!(variable("1é", &[]), "x1_");
        let long = "a".repeat(100);
        assert_eq!(variable(&long, &[]).len(), MAX_NAME);
        assert_eq!(variable(&long, &["a".repeat(MAX_NAME)]).len(), MAX_NAME);
        assert_eq!(variable("", &[]), "x");
    }
}
