//! The master's network information file (ENI, ETG.2100): from names to addresses.

use crate::files::read_text;
use lacuna_interfaces::BadInput;
use lacuna_interfaces::ethercat::{Axis, Ethercat, Place};
use roxmltree::{Document, Node};
use std::path::Path;

/// The CiA 402 objects that are read: index, bits.
const POSITION: (u32, u32) = (0x6064, 32);
const TORQUE: (u32, u32) = (0x6077, 16);
const VELOCITY: (u32, u32) = (0x606C, 32);
const STATUS: (u32, u32) = (0x6041, 16);

/// Looks the table's names up in its ENI file, so that only addresses remain. Without `[[ethercat.axis]]` tables the
/// slaves with a position and a torque are the joints, in the file's order. Unchanged if the table names no file.
///
/// # Errors
/// [`BadInput`] with the ENI file: absent, not XML, or without what the table names.
pub fn resolve(table: &Ethercat, folder: &Path, joints: usize) -> Result<Ethercat, BadInput> {
    let Some(eni) = &table.eni else { return Ok(table.clone()) };
    let path = folder.join(eni);
    let text = read_text(&path)?;
    resolved(table, &text, joints).map_err(|e| e.in_file(&path))
}

fn resolved(table: &Ethercat, text: &str, joints: usize) -> Result<Ethercat, BadInput> {
    let document = Document::parse(text).map_err(|e| {
        BadInput::new(format!("found no well-formed XML: {e}; expected an ENI file")).at_line(u64::from(e.pos().row))
    })?;
    let config = Configuration::read(&document)?;
    let mut out = table.clone();
    out.eni = None;
    if out.axis.is_empty() {
        let drives = config.slaves.iter().filter(|s| s.object(POSITION).is_some() && s.object(TORQUE).is_some());
        out.axis = drives.map(|s| Axis { slave: Some(s.name.clone()), ..Axis::default() }).collect();
        if out.axis.len() != joints {
            let names: Vec<&str> = out.axis.iter().filter_map(|a| a.slave.as_deref()).collect();
            return Err(BadInput::new(format!(
                "found {} drives with position and torque ({}); expected {joints}, one per joint, or [[ethercat.axis]] \
                 tables that say which they are",
                names.len(),
                names.join(", ")
            )));
        }
    }
    for axis in &mut out.axis {
        config.place(axis)?;
    }
    out.cycle_s = out.cycle_s.or(config.cycle_s);
    Ok(out)
}

/// A slave and its inputs: object index, bits, bit offset in the input image.
#[derive(Debug)]
struct Slave {
    name: String,
    inputs: Vec<(u32, u32, u32)>,
}

impl Slave {
    fn object(&self, (index, bits): (u32, u32)) -> Option<u32> {
        self.inputs.iter().find(|i| i.0 == index && i.1 == bits).map(|i| i.2)
    }
}

/// A cyclic command that fills a part of the input image.
#[derive(Debug)]
struct Filled {
    from_byte: u32,
    bytes: u32,
    address: Place,
}

/// What is needed of the file.
#[derive(Debug)]
struct Configuration {
    slaves: Vec<Slave>,
    variables: Vec<(String, u32, u32)>,
    filled: Vec<Filled>,
    cycle_s: Option<f64>,
}

fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|c| c.has_tag_name(name))
}

fn text<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
    child(node, name).and_then(|c| c.text()).map(str::trim)
}

/// A number: decimal, or `#x` and hexadecimal digits.
fn number(node: Node<'_, '_>, name: &str) -> Option<u32> {
    let text = text(node, name)?;
    match text.strip_prefix("#x").or_else(|| text.strip_prefix("0x")) {
        Some(digits) => u32::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    }
}

impl Configuration {
    fn read(document: &Document<'_>) -> Result<Self, BadInput> {
        let root = document.root_element();
        let config = child(root, "Config").filter(|_| root.has_tag_name("EtherCATConfig"));
        let config = config.ok_or_else(|| {
            BadInput::new(format!(
                "found <{}>; expected <EtherCATConfig><Config>, as in an ENI file",
                root.tag_name().name()
            ))
        })?;
        let tagged = |node: Node<'_, '_>, name: &'static str| -> Vec<_> {
            node.children().filter(|c| c.has_tag_name(name)).map(|c| c.id()).collect()
        };
        let nodes = |ids: Vec<roxmltree::NodeId>| ids.into_iter().filter_map(|id| document.get_node(id));
        let slaves = nodes(tagged(config, "Slave")).map(slave).collect();
        let inputs = child(config, "ProcessImage").and_then(|p| child(p, "Inputs"));
        let variables = inputs.map_or_else(Vec::new, |inputs| {
            let each = nodes(tagged(inputs, "Variable"));
            each.filter_map(|v| Some((text(v, "Name")?.to_owned(), number(v, "BitSize")?, number(v, "BitOffs")?)))
                .collect()
        });
        let cyclic = child(config, "Cyclic");
        let commands = cyclic.map_or_else(Vec::new, |c| {
            c.descendants()
                .filter(|n| n.has_tag_name("Cmd") && n.parent().is_some_and(|p| p.has_tag_name("Frame")))
                .collect()
        });
        Ok(Self {
            slaves,
            variables,
            filled: commands.into_iter().filter_map(filled).collect(),
            cycle_s: cyclic.and_then(|c| number(c, "CycleTime")).filter(|us| *us > 0).map(|us| f64::from(us) * 1e-6),
        })
    }

    /// The address of `bits` bits at a place of the input image.
    fn address(&self, what: &str, bits: u32, bit: u32) -> Result<Place, BadInput> {
        if !bit.is_multiple_of(8) {
            return Err(BadInput::new(format!("{what}: found it at bit {bit}; expected a whole byte")));
        }
        let byte = bit / 8;
        let covers = |f: &&Filled| {
            f.from_byte <= byte && u64::from(byte) + u64::from(bits / 8) <= u64::from(f.from_byte) + u64::from(f.bytes)
        };
        let filled = self.filled.iter().find(covers).ok_or_else(|| {
            BadInput::new(format!(
                "{what}: found no cyclic command that fills byte {byte} of the input image; expected LRD, LRW, FPRD or FPRW"
            ))
        })?;
        let into = byte - filled.from_byte;
        let beyond = || BadInput::new(format!("{what}: found an address beyond its range; expected one within it"));
        Ok(match &filled.address {
            Place::Station { station, offset } => {
                let offset = u16::try_from(u32::from(*offset) + into).map_err(|_| beyond())?;
                Place::Station { station: *station, offset }
            }
            Place::Logical(address) => Place::Logical(address.checked_add(into).ok_or_else(beyond)?),
            Place::Variable(_) => return Err(beyond()),
        })
    }

    /// Replaces an axis's names by addresses.
    fn place(&self, axis: &mut Axis) -> Result<(), BadInput> {
        let slave = axis.slave.take().map(|name| self.slave(&name)).transpose()?;
        let objects = [
            (&mut axis.position, POSITION, true),
            (&mut axis.torque, TORQUE, true),
            (&mut axis.velocity, VELOCITY, false),
            (&mut axis.status, STATUS, false),
        ];
        for (place, object, needed) in objects {
            let (index, bits) = object;
            if let Some(Place::Variable(name)) = place {
                *place = Some(self.variable(name, bits)?);
            } else if let (None, Some(slave)) = (&place, slave) {
                let what = format!("slave \"{}\", object {index:#06x}", slave.name);
                match slave.object(object) {
                    Some(bit) => *place = Some(self.address(&what, bits, bit)?),
                    None if needed => {
                        let found: Vec<String> = slave.inputs.iter().map(|i| format!("{:#06x}", i.0)).collect();
                        return Err(BadInput::new(format!(
                            "{what}: found only {} in its inputs; expected it with {bits} bits",
                            if found.is_empty() { "nothing".to_owned() } else { found.join(", ") }
                        )));
                    }
                    None => {}
                }
            }
        }
        Ok(())
    }

    fn slave(&self, name: &str) -> Result<&Slave, BadInput> {
        self.slaves.iter().find(|s| s.name == name).ok_or_else(|| {
            let names: Vec<&str> = self.slaves.iter().map(|s| s.name.as_str()).take(20).collect();
            BadInput::new(format!("found slaves {}; expected also \"{name}\"", names.join(", ")))
        })
    }

    fn variable(&self, name: &str, bits: u32) -> Result<Place, BadInput> {
        let (_, size, bit) = self.variables.iter().find(|v| v.0 == name).ok_or_else(|| {
            BadInput::new(format!("found no input variable \"{name}\"; expected it, since the robot file names it"))
        })?;
        if *size != bits {
            return Err(BadInput::new(format!("variable \"{name}\": found {size} bits; expected {bits}")));
        }
        self.address(&format!("variable \"{name}\""), bits, *bit)
    }
}

/// A slave's inputs: its PDOs' entries one behind the other, from where its process data begin.
fn slave(node: Node<'_, '_>) -> Slave {
    let name = child(node, "Info").and_then(|i| text(i, "Name")).unwrap_or("").to_owned();
    let mut inputs = Vec::new();
    if let Some(data) = child(node, "ProcessData")
        && let Some(start) = child(data, "Recv").and_then(|r| number(r, "BitStart"))
    {
        let mut bit = start;
        // A PDO without a sync manager is not transferred.
        let pdos = data.children().filter(|c| c.has_tag_name("TxPdo") && c.has_attribute("Sm"));
        for entry in pdos.flat_map(|pdo| pdo.children().filter(|c| c.has_tag_name("Entry"))) {
            let bits = number(entry, "BitLen").unwrap_or(0);
            inputs.push((number(entry, "Index").unwrap_or(0), bits, bit));
            bit = bit.saturating_add(bits);
        }
    }
    Slave { name, inputs }
}

/// A command that reads into the input image.
fn filled(cmd: Node<'_, '_>) -> Option<Filled> {
    let code = u8::try_from(number(cmd, "Cmd")?).ok()?;
    let command = super::Command::from(code);
    if !command.reads() {
        return None;
    }
    let address = if command.logical() {
        Place::Logical(number(cmd, "Addr")?)
    } else {
        let half = |name| number(cmd, name).and_then(|v| u16::try_from(v).ok());
        Place::Station { station: half("Adp")?, offset: half("Ado")? }
    };
    Some(Filled { from_byte: number(cmd, "InputOffs")?, bytes: number(cmd, "DataLength")?, address })
}
