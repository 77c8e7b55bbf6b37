//! Parquet: a row group per block, zstd; numbers as `DOUBLE` with their bytes apart (they compress better so), counts as
//! `INT64`, flags as `BOOLEAN`, a missing value as null. The file's metadata says what the columns are: `lacuna.columns`,
//! a JSON list of name, group, joint, topic, unit.

use super::{Format, TableSink};
use crate::file::ExportError;
use crate::table::{Block, Column, Kind, Table};
use parquet::basic::{Compression, Encoding, Repetition, Type as Physical, ZstdLevel};
use parquet::data_type::{BoolType, DoubleType, Int64Type};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{WriterProperties, WriterPropertiesBuilder};
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::{ColumnPath, Type, TypePtr};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::sync::Arc;

/// The registry's line.
pub(crate) const FORMAT: Format = Format { name: "Parquet", extension: "parquet", create };

/// How hard zstd tries.
const LEVEL: i32 = 3;

fn create(file: File, table: &Table, _folder: &Path) -> Result<Box<dyn TableSink>, ExportError> {
    let mut fields = vec![
        field("t_s", Physical::DOUBLE, Repetition::REQUIRED)?,
        field("stamp_ns", Physical::INT64, Repetition::REQUIRED)?,
    ];
    for column in &table.columns {
        fields.push(field(&column.name, physical(column.kind), Repetition::OPTIONAL)?);
    }
    let mut properties = properties("lacuna.export/1", &about(table))?;
    for name in std::iter::once("t_s").chain(floats(table)) {
        let path = ColumnPath::new(vec![name.to_owned()]);
        properties = properties.set_column_encoding(path.clone(), Encoding::BYTE_STREAM_SPLIT);
        properties = properties.set_column_dictionary_enabled(path, false);
    }
    let stamp = ColumnPath::new(vec!["stamp_ns".to_owned()]);
    properties = properties.set_column_encoding(stamp.clone(), Encoding::DELTA_BINARY_PACKED);
    properties = properties.set_column_dictionary_enabled(stamp, false);
    let writer = SerializedFileWriter::new(BufWriter::new(file), schema(fields)?, Arc::new(properties.build()))?;
    Ok(Box::new(Parquet { writer, table: table.clone() }))
}

fn floats(table: &Table) -> impl Iterator<Item = &str> {
    table.columns.iter().filter(|c| c.kind == Kind::Float).map(|c| c.name.as_str())
}

fn about(table: &Table) -> Vec<(&'static str, String)> {
    let column = |c: &Column| serde_json::json!({ "name": c.name, "group": c.group, "joint": c.joint, "topic": c.topic, "unit": c.unit });
    let columns: Vec<serde_json::Value> = table.columns.iter().map(column).collect();
    let mut about = vec![
        ("lacuna.columns", serde_json::Value::from(columns).to_string()),
        ("lacuna.recording", table.recording.clone()),
        ("lacuna.origin_ns", table.origin_ns.to_string()),
    ];
    about.extend(table.robot.iter().map(|robot| ("lacuna.robot", robot.clone())));
    about
}

fn physical(kind: Kind) -> Physical {
    match kind {
        Kind::Float => Physical::DOUBLE,
        Kind::Integer => Physical::INT64,
        Kind::Flag => Physical::BOOLEAN,
    }
}

/// A column of the schema.
pub(crate) fn field(name: &str, physical: Physical, repetition: Repetition) -> Result<TypePtr, ExportError> {
    let mut builder = Type::primitive_type_builder(name, physical).with_repetition(repetition);
    if physical == Physical::BYTE_ARRAY {
        builder = builder.with_logical_type(Some(parquet::basic::LogicalType::String));
    }
    Ok(Arc::new(builder.build()?))
}

/// A schema of these columns.
pub(crate) fn schema(fields: Vec<TypePtr>) -> Result<TypePtr, ExportError> {
    Ok(Arc::new(Type::group_type_builder("lacuna").with_fields(fields).build()?))
}

/// What all files have in common: compression, who wrote it, facts about it.
pub(crate) fn properties(kind: &str, about: &[(&str, String)]) -> Result<WriterPropertiesBuilder, ExportError> {
    let facts = about.iter().map(|(key, value)| KeyValue::new((*key).to_owned(), value.clone()));
    let facts = std::iter::once(KeyValue::new("lacuna.schema".to_owned(), kind.to_owned())).chain(facts).collect();
    Ok(WriterProperties::builder()
        .set_created_by(concat!("lacuna ", env!("CARGO_PKG_VERSION")).to_owned())
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(LEVEL)?))
        .set_key_value_metadata(Some(facts)))
}

struct Parquet {
    writer: SerializedFileWriter<BufWriter<File>>,
    table: Table,
}

/// The values that are there, and for every row whether there is one.
fn present<T>(values: &[f64], convert: impl Fn(f64) -> T) -> (Vec<T>, Vec<i16>) {
    let levels = values.iter().map(|v| i16::from(!v.is_nan())).collect();
    (values.iter().filter(|v| !v.is_nan()).map(|v| convert(*v)).collect(), levels)
}

fn column(writer: &mut SerializedColumnWriter<'_>, kind: Kind, values: &[f64]) -> Result<(), ExportError> {
    match kind {
        Kind::Float => {
            let (values, levels) = present(values, |v| v);
            writer.typed::<DoubleType>().write_batch(&values, Some(&levels), None)?;
        }
        Kind::Integer => {
            // A cast from f64 saturates.
            let (values, levels) = present(values, |v| v as i64);
            writer.typed::<Int64Type>().write_batch(&values, Some(&levels), None)?;
        }
        Kind::Flag => {
            let (values, levels) = present(values, |v| v != 0.0);
            writer.typed::<BoolType>().write_batch(&values, Some(&levels), None)?;
        }
    }
    Ok(())
}

impl TableSink for Parquet {
    fn block(&mut self, block: &Block) -> Result<(), ExportError> {
        let times: Vec<f64> = block.stamps_ns.iter().map(|ns| self.table.t_s(*ns)).collect();
        let mut group = self.writer.next_row_group()?;
        let mut values = block.values.iter().zip(&self.table.columns);
        let mut index = 0;
        while let Some(mut writer) = group.next_column()? {
            match index {
                0 => {
                    writer.typed::<DoubleType>().write_batch(&times, None, None)?;
                }
                1 => {
                    writer.typed::<Int64Type>().write_batch(&block.stamps_ns, None, None)?;
                }
                _ => {
                    if let Some((values, of)) = values.next() {
                        column(&mut writer, of.kind, values)?;
                    }
                }
            }
            writer.close()?;
            index += 1;
        }
        group.close()?;
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<(), ExportError> {
        let buffer = self.writer.into_inner()?;
        buffer.into_inner().map_err(|e| ExportError::write(e.into_error())).map(|_| ())
    }
}
