//! Small Parquet tables of results, one per robot, made to be read a thousand at a time: the same columns with the same
//! types in every file, whatever was found.

use crate::file::ExportError;
use crate::formats::parquet::{field, properties, schema};
use parquet::basic::{Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use std::sync::Arc;

/// What a column of results holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellKind {
    /// Text.
    Text,
    /// A number.
    Number,
    /// A whole number.
    Count,
    /// Yes or no.
    Flag,
}

/// A column of results.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ResultColumn {
    /// Name.
    pub name: &'static str,
    /// What it holds.
    pub kind: CellKind,
    /// What it is, in words, with its unit.
    pub meaning: &'static str,
}

/// A value; `None` is null.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// Text.
    Text(Option<String>),
    /// A number; one that is not finite is null.
    Number(Option<f64>),
    /// A whole number.
    Count(Option<i64>),
    /// Yes or no.
    Flag(Option<bool>),
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(Some(text.to_owned()))
    }
}

impl From<f64> for Cell {
    fn from(value: f64) -> Self {
        Self::Number(value.is_finite().then_some(value))
    }
}

impl From<Option<f64>> for Cell {
    fn from(value: Option<f64>) -> Self {
        Self::Number(value.filter(|v| v.is_finite()))
    }
}

impl From<usize> for Cell {
    fn from(n: usize) -> Self {
        Self::Count(i64::try_from(n).ok())
    }
}

impl From<bool> for Cell {
    fn from(yes: bool) -> Self {
        Self::Flag(Some(yes))
    }
}

/// The bytes of a Parquet file with these rows. A cell of another kind than its column's, or a missing one, is null.
///
/// # Errors
/// [`ExportError`] if the Parquet library refuses.
pub fn to_parquet(kind: &str, columns: &[ResultColumn], rows: &[Vec<Cell>]) -> Result<Vec<u8>, ExportError> {
    let physical = |c: &ResultColumn| match c.kind {
        CellKind::Text => Physical::BYTE_ARRAY,
        CellKind::Number => Physical::DOUBLE,
        CellKind::Count => Physical::INT64,
        CellKind::Flag => Physical::BOOLEAN,
    };
    let fields = columns.iter().map(|c| field(c.name, physical(c), Repetition::OPTIONAL)).collect::<Result<_, _>>()?;
    let meanings: Vec<serde_json::Value> =
        columns.iter().map(|c| serde_json::json!({ "name": c.name, "meaning": c.meaning })).collect();
    let about = [("lacuna.columns", serde_json::Value::from(meanings).to_string())];
    let properties = properties(kind, &about)?.build();
    let mut writer = SerializedFileWriter::new(Vec::new(), schema(fields)?, Arc::new(properties))?;
    let mut group = writer.next_row_group()?;
    let mut list = columns.iter().enumerate();
    while let Some(mut column) = group.next_column()? {
        if let Some((index, of)) = list.next() {
            let cells = || rows.iter().map(|row| row.get(index));
            put(&mut column, of.kind, cells)?;
        }
        column.close()?;
    }
    group.close()?;
    Ok(writer.into_inner()?)
}

fn put<'a, I: Iterator<Item = Option<&'a Cell>>>(
    column: &mut SerializedColumnWriter<'_>,
    kind: CellKind,
    cells: impl Fn() -> I,
) -> Result<(), ExportError> {
    /// The values that are there, and for every row whether there is one.
    fn split<T>(values: impl Iterator<Item = Option<T>>) -> (Vec<T>, Vec<i16>) {
        let values: Vec<Option<T>> = values.collect();
        let levels = values.iter().map(|v| i16::from(v.is_some())).collect();
        (values.into_iter().flatten().collect(), levels)
    }
    match kind {
        CellKind::Text => {
            let text = |c: Option<&Cell>| match c {
                Some(Cell::Text(Some(text))) => Some(ByteArray::from(text.as_str())),
                _ => None,
            };
            let (values, levels) = split(cells().map(text));
            column.typed::<ByteArrayType>().write_batch(&values, Some(&levels), None)?;
        }
        CellKind::Number => {
            let (values, levels) = split(cells().map(|c| if let Some(Cell::Number(v)) = c { *v } else { None }));
            column.typed::<DoubleType>().write_batch(&values, Some(&levels), None)?;
        }
        CellKind::Count => {
            let (values, levels) = split(cells().map(|c| if let Some(Cell::Count(v)) = c { *v } else { None }));
            column.typed::<Int64Type>().write_batch(&values, Some(&levels), None)?;
        }
        CellKind::Flag => {
            let (values, levels) = split(cells().map(|c| if let Some(Cell::Flag(v)) = c { *v } else { None }));
            column.typed::<BoolType>().write_batch(&values, Some(&levels), None)?;
        }
    }
    Ok(())
}
