//! The first pass over a recording's messages: which columns there are.

use crate::Request;
use crate::columns::{Field, base_of, fields_of, is_known};
use crate::table::{Column, Table};
use lacuna_interfaces::BadInput;
use lacuna_recording::messages::{MessageTopic, Messages, one_line};
use lacuna_recording::ros::definition::{Decoded, Primitive, Scalar};
use std::collections::BTreeSet;

/// Most columns of a table.
const MAX_COLUMNS: usize = 4096;

/// How the messages of a recording become rows.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(crate) table: Table,
    /// By index of the topic in [`Messages::topics`]; `None` for those left out.
    pub(crate) topics: Vec<Option<TopicPlan>>,
    /// First stamp of what is exported [ns].
    pub(crate) first_ns: i64,
    /// Topics that are left out, with their type.
    pub(crate) left_out: Vec<String>,
}

/// How the messages of one topic become values of a row.
#[derive(Debug, Default)]
pub(crate) struct TopicPlan {
    names: Names,
    fields: Vec<FieldPlan>,
    /// True after the first message.
    seen: bool,
}

#[derive(Debug)]
struct FieldPlan {
    field: Field,
    /// Whether its list goes by the topic's names.
    named: bool,
    /// By name or number: whether there was a value, and in the second pass its column.
    slots: Vec<Slot>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    used: bool,
    column: Option<usize>,
}

/// The joint names of a topic, over all its messages.
#[derive(Debug, Default)]
struct Names {
    /// Leaf that holds them.
    leaf: Option<usize>,
    list: Vec<String>,
    /// Bytes of the names in the message before, and where each stands in `list`.
    bytes: Vec<u8>,
    order: Vec<usize>,
}

impl Names {
    /// Adjusts to the names of a message; new ones are added.
    fn follow(&mut self, message: &[u8], decoded: &Decoded) {
        let Some(leaf) = self.leaf else { return };
        let texts = decoded.of(leaf);
        let (Some(Scalar::Text { start, .. }), Some(Scalar::Text { end, .. })) = (texts.first(), texts.last()) else {
            self.order.clear();
            self.bytes.clear();
            return;
        };
        // The lengths stand between the names, so equal bytes are equal names.
        let bytes = message.get(4 + start..4 + end).unwrap_or(&[]);
        if self.order.len() == texts.len() && self.bytes == bytes {
            return;
        }
        self.bytes.clear();
        self.bytes.extend_from_slice(bytes);
        self.order.clear();
        for text in texts {
            let name = lacuna_recording::ros::definition::text_of(message, *text).unwrap_or_default();
            let at = self.list.iter().position(|n| *n == name).unwrap_or_else(|| {
                self.list.push(name);
                self.list.len() - 1
            });
            self.order.push(at);
        }
    }
}

impl TopicPlan {
    fn of(topic: &MessageTopic, torque_unit: &str) -> Self {
        let Some(layout) = &topic.layout else { return Self::default() };
        let leaf = layout.find("name").filter(|&i| {
            layout.leaves().get(i).is_some_and(|l| {
                l.primitive == Primitive::Text && l.arity != lacuna_recording::ros::definition::Arity::One
            })
        });
        let fields = fields_of(topic, torque_unit)
            .into_iter()
            .map(|field| FieldPlan { named: leaf.is_some() && field.list, field, slots: Vec::new() })
            .collect();
        Self { names: Names { leaf, ..Names::default() }, fields, seen: false }
    }

    /// Takes note of which columns a message has values for.
    fn learn(&mut self, message: &[u8], decoded: &Decoded) -> Result<(), BadInput> {
        self.seen = true;
        self.names.follow(message, decoded);
        let mut columns = 0;
        for field in &mut self.fields {
            for (i, value) in decoded.of(field.field.leaf).iter().enumerate() {
                let Some(slot) = (if field.named { self.names.order.get(i).copied() } else { Some(i) }) else { break };
                if slot >= field.slots.len() {
                    if slot >= MAX_COLUMNS {
                        return Err(too_many());
                    }
                    field.slots.resize(slot + 1, Slot::default());
                }
                if let Some(slot) = field.slots.get_mut(slot)
                    && !slot.used
                {
                    slot.used = value.number().is_some_and(f64::is_finite);
                }
            }
            columns += field.slots.len();
        }
        if columns > MAX_COLUMNS { Err(too_many()) } else { Ok(()) }
    }

    /// Calls `put(column, value)` for every value of a message that has a column; NaN is none.
    pub(crate) fn values(&mut self, message: &[u8], decoded: &Decoded, mut put: impl FnMut(usize, f64)) {
        self.names.follow(message, decoded);
        for field in &self.fields {
            for (i, value) in decoded.of(field.field.leaf).iter().enumerate() {
                let Some(slot) = (if field.named { self.names.order.get(i).copied() } else { Some(i) }) else { break };
                let column = field.slots.get(slot).and_then(|s| s.column);
                if let (Some(column), Some(number)) = (column, value.number())
                    && !number.is_nan()
                {
                    put(column, number);
                }
            }
        }
    }

    /// Appends the columns for which there was a value.
    fn columns(&mut self, topic: &str, out: &mut Vec<Column>) {
        for plan in &mut self.fields {
            for (i, slot) in plan.slots.iter_mut().enumerate().filter(|(_, s)| s.used) {
                slot.column = Some(out.len());
                let joint = match (plan.field.list, plan.named) {
                    (true, true) => self.names.list.get(i).cloned(),
                    (true, false) => Some((i + 1).to_string()),
                    (false, _) => None,
                };
                let Field { group, unit, kind, .. } = &plan.field;
                let name = joint.as_ref().map_or_else(|| group.clone(), |joint| format!("{group}_{joint}"));
                let (group, unit, topic) = (group.clone(), unit.clone(), topic.to_owned());
                out.push(Column { name, group, joint, topic, unit, kind: *kind });
            }
        }
    }
}

fn too_many() -> BadInput {
    BadInput::new(format!("found more than {MAX_COLUMNS} columns; expected fewer, by a choice of topics"))
}

impl Plan {
    /// Reads the recording through. `progress` hears 0 to 0.5.
    ///
    /// # Errors
    /// [`BadInput`] if it is damaged, a topic that was asked for is not in it, or there is nothing to export.
    pub(crate) fn of(request: &Request<'_>, progress: &mut dyn FnMut(f64)) -> Result<Self, BadInput> {
        let mut messages = Messages::open(request.recording)?;
        let mut topics: Vec<Option<TopicPlan>> = Vec::new();
        let mut spoken: Vec<bool> = Vec::new();
        let mut decoded = Decoded::default();
        let mut first_ns = i64::MAX;
        let mut read: u64 = 0;
        while let Some(message) = messages.next_message()? {
            read += 1;
            if read.is_multiple_of(1 << 14) {
                progress(0.5 * messages.fraction());
            }
            while topics.len() < messages.topics().len() {
                topics.push(chosen(&messages, topics.len(), request.topics));
            }
            spoken.resize(topics.len(), false);
            spoken.get_mut(message.topic).into_iter().for_each(|s| *s = true);
            let (Some(topic), Some(Some(plan))) = (messages.topic(message.topic), topics.get_mut(message.topic)) else {
                continue;
            };
            first_ns = first_ns.min(message.stamp_ns);
            let learned =
                topic.decode(messages.data(), &mut decoded).and_then(|()| plan.learn(messages.data(), &decoded));
            learned.map_err(|e| e.in_file(messages.path()))?;
        }
        let table = table(&messages, &mut topics, first_ns);
        let path = messages.path();
        let missing: Vec<&str> = request.topics.iter().map(String::as_str).filter(|t| !has(&messages, t)).collect();
        if !missing.is_empty() || table.columns.is_empty() {
            let there: Vec<String> = messages.topics().iter().map(shown).collect();
            let there = if there.is_empty() { "no topics".to_owned() } else { there.join(", ") };
            let wanted = match missing.as_slice() {
                [] => "joint signals (sensor_msgs/msg/JointState) or a choice of topics with numbers".to_owned(),
                list => format!("topic {}", list.join(", ")),
            };
            return Err(BadInput::new(format!("found {there}; expected {wanted}")).in_file(path));
        }
        // A topic without a message leaves nothing out.
        let left_out = |((t, plan), spoken): ((&MessageTopic, &Option<TopicPlan>), &bool)| {
            (*spoken && plan.is_none()).then(|| shown(t))
        };
        let left_out = messages.topics().iter().zip(&topics).zip(&spoken).filter_map(left_out).collect();
        Ok(Self { table, topics, first_ns, left_out })
    }
}

/// A topic with its type.
fn shown(topic: &MessageTopic) -> String {
    format!("{} ({})", one_line(&topic.name), one_line(&topic.schema))
}

fn has(messages: &Messages, topic: &str) -> bool {
    messages.topics().iter().any(|t| t.name == topic)
}

/// Whether and how a topic is exported.
fn chosen(messages: &Messages, index: usize, wanted: &[String]) -> Option<TopicPlan> {
    let topic = messages.topic(index)?;
    let take = if wanted.is_empty() { is_known(topic) } else { wanted.contains(&topic.name) };
    (take && topic.layout.is_some()).then(|| TopicPlan::of(topic, torque_unit(messages)))
}

/// The unit of every torque, as our own recorder notes it; by ROS convention Nm.
fn torque_unit(messages: &Messages) -> &str {
    messages.metadata().get("lacuna").and_then(|m| m.get("torque_unit")).map_or("Nm", String::as_str)
}

/// The columns: topics as they were declared, the details of a topic behind it.
fn table(messages: &Messages, topics: &mut [Option<TopicPlan>], first_ns: i64) -> Table {
    let list = messages.topics();
    let bases: Vec<&str> = list.iter().map(base_of).collect();
    let mut order: Vec<usize> = (0..topics.len()).collect();
    order.sort_by_key(|&i| {
        let base = bases.get(i).copied().unwrap_or("");
        (bases.iter().position(|b| *b == base), list.get(i).is_some_and(|t| t.name != base))
    });
    let mut columns = Vec::new();
    for i in order {
        if let (Some(topic), Some(Some(plan))) = (list.get(i), topics.get_mut(i)) {
            plan.columns(&topic.name, &mut columns);
        }
    }
    let recording = messages.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
    let robot = messages.metadata().get("lacuna").and_then(|m| m.get("robot")).cloned();
    // Nothing exported has no first stamp.
    let first_ns = if first_ns == i64::MAX { 0 } else { first_ns };
    let mut table = Table { columns, recording, robot, origin_ns: Table::origin_of(first_ns) };
    table.distinguish();
    table
}

/// Topics that hold a message.
pub(crate) fn with_messages(topics: &[Option<TopicPlan>]) -> BTreeSet<usize> {
    topics.iter().enumerate().filter(|(_, t)| t.as_ref().is_some_and(|t| t.seen)).map(|(i, _)| i).collect()
}
