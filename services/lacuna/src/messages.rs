//! `lacuna messages`: the bus's messages as another language declares them, from the same tables that the stages use.

use crate::{CommandResult, words};
use clap::Args;
use lacuna_interfaces::wire::{Definition, Field, Header, MAX_HOPS, MAX_JOINTS, MESSAGES};
use lacuna_interfaces::{flag, region};
use lacuna_stage::Failure;
use std::fmt::Write;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Args)]
pub struct MessagesArgs {
    /// Python: ctypes structures, as the `iceoryx2` package takes them.
    #[arg(long, required = true)]
    python: bool,
    /// Write to this file instead of standard output.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// `lacuna messages`.
pub fn messages(args: &MessagesArgs) -> CommandResult {
    let text = python()?;
    match &args.out {
        Some(path) => words::write(path, text.as_bytes())?,
        None => words::say(&text)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// ctypes type of a field.
fn ctype(field: &Field) -> Result<String, Failure> {
    Ok(match field.ty {
        "Header" => "Header".to_owned(),
        "u32" => "ctypes.c_uint32".to_owned(),
        "u64" => "ctypes.c_uint64".to_owned(),
        "i64" => "ctypes.c_int64".to_owned(),
        "f64" => "ctypes.c_double".to_owned(),
        "Joints" => "ctypes.c_double * MAX_JOINTS".to_owned(),
        "Stamps" => "ctypes.c_int64 * MAX_JOINTS".to_owned(),
        "Words" => "ctypes.c_uint32 * MAX_JOINTS".to_owned(),
        "Hops" => "ctypes.c_uint64 * MAX_HOPS".to_owned(),
        other => {
            return Err(Failure::run(format!("field {}: found type {other}, which has no ctypes name", field.name)));
        }
    })
}

fn structure(out: &mut String, name: &str, fields: &[Field]) -> Result<(), Failure> {
    // Writing to a String cannot fail.
    let _ = writeln!(out, "\n\nclass {name}(ctypes.Structure):\n    _fields_ = [");
    for field in fields {
        let _ = writeln!(out, "        (\"{}\", {}),", field.name, ctype(field)?);
    }
    out.push_str("    ]\n");
    Ok(())
}

/// Sizes and offsets as this program has them: a Python that lays them out otherwise must not reach the bus.
fn checks(out: &mut String, name: &str, size: usize, fields: &[Field]) {
    let offsets: Vec<String> = fields.iter().map(|f| f.offset.to_string()).collect();
    let _ = writeln!(out, "    ({name}, {size}, [{}]),", offsets.join(", "));
}

/// The Python module.
fn python() -> Result<String, Failure> {
    let mut out = format!(
        "\"\"\"Messages on Lacuna's bus. Made by `lacuna messages --python` (lacuna {}); make it anew after an update.\n\n\
         The type name of a message holds a hash over all its fields: two layouts never meet on one topic.\n\"\"\"\n\n\
         import ctypes\n\nMAX_JOINTS = {MAX_JOINTS}\nMAX_HOPS = {MAX_HOPS}\n\n# Bits of Header.flags.\n",
        env!("CARGO_PKG_VERSION")
    );
    for (name, value) in flag::ALL {
        let _ = writeln!(out, "{name} = {value:#x}");
    }
    out.push_str("\n# Values of ResidualWatch.region_variable.\n");
    for (name, value) in
        [("TIME", region::TIME), ("VELOCITY", region::VELOCITY), ("POSITION", region::POSITION), ("LOAD", region::LOAD)]
    {
        let _ = writeln!(out, "REGION_{name} = {value}");
    }
    structure(&mut out, "Header", Header::FIELDS)?;
    for Definition { name, type_name, fields, .. } in MESSAGES {
        structure(&mut out, name, fields)?;
        let type_name = type_name();
        let _ = write!(out, "\n    @staticmethod\n    def type_name():\n        return \"{type_name}\"\n");
    }
    out.push_str("\n\nfor _type, _size, _offsets in [\n");
    checks(&mut out, "Header", size_of::<Header>(), Header::FIELDS);
    MESSAGES.iter().for_each(|m| checks(&mut out, m.name, m.size, m.fields));
    out.push_str(
        "]:\n    _found = [getattr(_type, _name).offset for _name, _ in _type._fields_]\n    \
         if ctypes.sizeof(_type) != _size or _found != _offsets:\n        \
         raise ImportError(f\"{_type.__name__}: found another layout than lacuna's: {_found}; expected {_offsets}\")\n",
    );
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_message_field_and_flag_is_there() {
        let text = python().unwrap();
        for message in MESSAGES {
            assert!(text.contains(&format!("class {}(ctypes.Structure):", message.name)), "{}", message.name);
            assert!(text.contains(&(message.type_name)()), "{}", message.name);
            for field in message.fields {
                assert!(text.contains(&format!("(\"{}\", ", field.name)), "{}.{}", message.name, field.name);
            }
        }
        assert!(text.contains("END_OF_STREAM = 0x1\n") && text.contains("MISMATCH = 0x400\n"));
    }
}
