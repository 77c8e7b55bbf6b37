//! A recording's samples as every other command reads them: judged, repaired, flagged, joints in the robot's order.

use crate::columns::torque_name;
use crate::table::{BLOCK_ROWS, Block, Column, Kind, Table};
use crate::{Exported, Request, RowSource};
use lacuna_interfaces::{BadInput, JointMeasured, Joints, RobotFile};
use lacuna_recording::{ReadOptions, Reader, Sample};

/// Rows of samples.
pub(crate) struct Samples {
    reader: Reader,
    table: Table,
    /// Where each column's value comes from.
    fields: Vec<Field>,
    first_ns: i64,
    from_s: f64,
    to_s: f64,
    row: Vec<f64>,
}

/// Where a value comes from in a [`Sample`].
#[derive(Debug, Clone, Copy)]
enum Field {
    Joint(fn(&JointMeasured) -> &Joints, usize),
    Extra(usize),
    Flags,
}

/// Name in the notation, unit (`None`: the robot's torque unit), where the joints' values are.
type Quantity = (&'static str, Option<&'static str>, fn(&JointMeasured) -> &Joints);

const QUANTITIES: [Quantity; 5] = [
    ("q_rad", Some("rad"), |m| &m.q_rad),
    ("tau_nm", None, |m| &m.tau_nm),
    ("temperature_degc", Some("°C"), |m| &m.temperature_degc),
    ("link_q_rad", Some("rad"), |m| &m.link_q_rad),
    ("link_tau_nm", None, |m| &m.link_tau_nm),
];

impl Field {
    fn value(self, sample: &Sample) -> f64 {
        match self {
            Self::Joint(list, j) => list(&sample.measured).get(j).copied().unwrap_or(f64::NAN),
            Self::Extra(i) => sample.extra.get(i).copied().unwrap_or(f64::NAN),
            Self::Flags => f64::from(sample.measured.header.flags),
        }
    }
}

impl Samples {
    /// Reads the recording through for its columns, and opens it for its rows.
    pub(crate) fn open(
        request: &Request<'_>,
        robot: &RobotFile,
        progress: &mut dyn FnMut(f64),
    ) -> Result<Self, BadInput> {
        let topic = match request.topics {
            [] => None,
            [one] => Some(one.clone()),
            more => {
                return Err(BadInput::new(format!(
                    "found topics {} with --robot; expected one, the joint signals",
                    more.join(", ")
                )));
            }
        };
        let options = ReadOptions { topic, extra: true, ..ReadOptions::default() };
        let open = || lacuna_recording::open_with(request.recording, robot, &options);
        let (mut columns, mut fields) = candidates(robot, &open()?);
        let (first_ns, used) = look(&mut open()?, &fields, progress)?;
        let mut keep = used.iter();
        columns.retain(|_| keep.next().is_some_and(|used| *used));
        let mut keep = used.iter();
        fields.retain(|_| keep.next().is_some_and(|used| *used));
        let reader = open()?;
        let recording = reader.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
        let origin_ns = Table::origin_of(first_ns);
        let mut table = Table { columns, recording, robot: Some(robot.name.clone()), origin_ns };
        table.distinguish();
        Ok(Self { reader, table, fields, first_ns, from_s: request.from_s, to_s: request.to_s, row: Vec::new() })
    }
}

/// All columns that there may be.
fn candidates(robot: &RobotFile, reader: &Reader) -> (Vec<Column>, Vec<Field>) {
    let mut columns = Vec::new();
    let mut fields = Vec::new();
    let topic = reader.about().topic.clone().unwrap_or_default();
    let torque = robot.torque_unit.symbol();
    for (name, unit, list) in QUANTITIES {
        let group = if unit.is_none() { torque_name(name, torque) } else { name.to_owned() };
        for (j, joint) in robot.joints.iter().enumerate() {
            columns.push(Column {
                name: format!("{group}_{joint}"),
                group: group.clone(),
                joint: Some(joint.clone()),
                topic: topic.clone(),
                unit: unit.unwrap_or(torque).to_owned(),
                kind: Kind::Float,
            });
            fields.push(Field::Joint(list, j));
        }
    }
    let mut single = |name: &str, kind, field| {
        let (topic, unit) = (topic.clone(), String::new());
        columns.push(Column { name: name.to_owned(), group: name.to_owned(), joint: None, topic, unit, kind });
        fields.push(field);
    };
    for (i, name) in reader.about().extra_names.iter().enumerate() {
        // The others are the robot file's own names of signals that have a column already.
        if name.starts_with("x_") {
            single(name, Kind::Float, Field::Extra(i));
        }
    }
    single("flags", Kind::Integer, Field::Flags);
    (columns, fields)
}

/// The first stamp, and which columns hold a value.
fn look(reader: &mut Reader, fields: &[Field], progress: &mut dyn FnMut(f64)) -> Result<(i64, Vec<bool>), BadInput> {
    let mut used = vec![false; fields.len()];
    let mut first_ns = None;
    let mut read: u64 = 0;
    loop {
        read += 1;
        if read.is_multiple_of(1 << 14) {
            progress(0.5 * reader.fraction());
        }
        let Some(sample) = reader.next_sample()? else { break };
        first_ns.get_or_insert(sample.measured.header.stamp_ns);
        for (used, field) in used.iter_mut().zip(fields).filter(|(used, _)| !**used) {
            *used = field.value(sample).is_finite();
        }
    }
    Ok((first_ns.unwrap_or(0), used))
}

impl RowSource for Samples {
    fn table(&self) -> &Table {
        &self.table
    }

    fn next_block(&mut self, block: &mut Block) -> Result<bool, BadInput> {
        block.clear();
        while block.len() < BLOCK_ROWS {
            let Some(sample) = self.reader.next_sample()? else { break };
            let stamp = sample.measured.header.stamp_ns;
            let since_s = (stamp - self.first_ns) as f64 / 1e9;
            if since_s >= self.to_s {
                break;
            }
            if since_s >= self.from_s {
                self.row.clear();
                self.row.extend(self.fields.iter().map(|field| field.value(sample)));
                block.push(stamp, &self.row);
            }
        }
        Ok(!block.is_empty())
    }

    fn fraction(&self) -> f64 {
        self.reader.fraction()
    }

    fn account(&self, exported: &mut Exported) {
        exported.repairs = self.reader.repairs();
        exported.left_out.clone_from(&self.reader.about().ignored);
    }
}
