//! Which field of a message becomes which column: the notation's names with their units.

use crate::table::Kind;
use lacuna_recording::messages::MessageTopic;
use lacuna_recording::ros::definition::{Arity, Leaf, Primitive};
use lacuna_recording::ros::schema;

/// Unit of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unit {
    /// This one.
    Is(&'static str),
    /// The robot's torque unit; `_nm` in the name becomes `_a` or `_v` with it.
    Torque,
}

/// A field whose meaning is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Quantity {
    schema: &'static str,
    field: &'static str,
    name: &'static str,
    unit: Unit,
}

const fn quantity(schema: &'static str, field: &'static str, name: &'static str, unit: Unit) -> Quantity {
    Quantity { schema, field, name, unit }
}

const JOINT: &str = schema::JOINT_STATE.name;
const MEASURED: &str = schema::MEASURED_DETAIL.name;
const MOTION: &str = schema::MOTION_DETAIL.name;
const PAYLOAD: &str = schema::PAYLOAD.name;
const WATCH: &str = schema::RESIDUAL_WATCH.name;
const STATUS: &str = schema::STATUS.name;
const NONE: Unit = Unit::Is("");

/// All of them.
const QUANTITIES: &[Quantity] = &[
    quantity(JOINT, "position", "q_rad", Unit::Is("rad")),
    quantity(JOINT, "velocity", "qd_rad_s", Unit::Is("rad/s")),
    quantity(JOINT, "effort", "tau_nm", Unit::Torque),
    quantity(MEASURED, "temperature", "temperature_degc", Unit::Is("°C")),
    quantity(MEASURED, "link_position", "link_q_rad", Unit::Is("rad")),
    quantity(MEASURED, "link_effort", "link_tau_nm", Unit::Torque),
    quantity(MEASURED, "drive_on", "drive_on", NONE),
    quantity(MOTION, "acceleration", "qdd_rad_s2", Unit::Is("rad/s²")),
    quantity(MOTION, "position_sd", "sd_q_rad", Unit::Is("rad")),
    quantity(MOTION, "velocity_sd", "sd_qd_rad_s", Unit::Is("rad/s")),
    quantity(MOTION, "acceleration_sd", "sd_qdd_rad_s2", Unit::Is("rad/s²")),
    quantity(PAYLOAD, "mass", "mass_kg", Unit::Is("kg")),
    quantity(PAYLOAD, "mass_sd", "sd_mass_kg", Unit::Is("kg")),
    quantity(PAYLOAD, "excited", "excited", NONE),
    quantity(PAYLOAD, "step", "step", NONE),
    quantity(WATCH, "residual", "residual_nm", Unit::Torque),
    quantity(WATCH, "residual_sd", "sd_nm", Unit::Torque),
    quantity(WATCH, "score", "score", NONE),
    quantity(WATCH, "watched", "watched", NONE),
    quantity(WATCH, "alarm", "alarm", NONE),
    quantity(WATCH, "since", "since_s", Unit::Is("s")),
    quantity(WATCH, "region_variable", "region_variable", NONE),
    quantity(WATCH, "region_low", "region_low", NONE),
    quantity(WATCH, "region_high", "region_high", NONE),
    quantity(STATUS, "seq", "seq", NONE),
    quantity(STATUS, "flags", "flags", NONE),
    quantity(STATUS, "lag_ns", "lag_ns", Unit::Is("ns")),
    quantity(STATUS, "dropped", "dropped", NONE),
    quantity(STATUS, "restarts", "restarts", NONE),
    quantity(STATUS, "hop_latency_ns", "hop_latency_ns", Unit::Is("ns")),
];

/// A field of a topic that becomes one column, or one per joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Field {
    /// Index of the leaf in the layout.
    pub(crate) leaf: usize,
    /// Topic and quantity.
    pub(crate) group: String,
    pub(crate) unit: String,
    pub(crate) kind: Kind,
    /// Whether it is a list: a column per entry.
    pub(crate) list: bool,
}

/// True if the meaning of a topic's fields is known.
pub(crate) fn is_known(topic: &MessageTopic) -> bool {
    topic.layout.is_some() && QUANTITIES.iter().any(|q| q.schema == topic.schema)
}

/// The fields of a topic that become columns: those that are known, or of an unknown type all numbers.
pub(crate) fn fields_of(topic: &MessageTopic, torque_unit: &str) -> Vec<Field> {
    let Some(layout) = &topic.layout else { return Vec::new() };
    let stem = stem_of(topic);
    let field = |leaf: usize, name: &str, unit: &str| {
        let of = layout.leaves().get(leaf)?;
        let group = if stem.is_empty() { name.to_owned() } else { format!("{stem}_{name}") };
        Some(Field { leaf, group, unit: unit.to_owned(), kind: kind_of(of)?, list: of.arity != Arity::One })
    };
    if is_known(topic) {
        let of_this = QUANTITIES.iter().filter(|q| q.schema == topic.schema);
        return of_this
            .filter_map(|q| {
                let leaf = layout.find(q.field)?;
                match q.unit {
                    Unit::Is(unit) => field(leaf, q.name, unit),
                    Unit::Torque => field(leaf, &torque_name(q.name, torque_unit), torque_unit),
                }
            })
            .collect();
    }
    let numbers = layout.leaves().iter().enumerate().filter(|(_, l)| !l.path.starts_with("header."));
    numbers.filter_map(|(i, l)| field(i, &l.path.replace('.', "_"), "")).collect()
}

/// `tau_nm` of a robot whose torques are in amperes is `tau_a`.
pub(crate) fn torque_name(name: &str, unit: &str) -> String {
    match unit {
        "A" | "V" => {
            name.strip_suffix("_nm").map_or_else(|| name.to_owned(), |n| format!("{n}_{}", unit.to_lowercase()))
        }
        _ => name.to_owned(),
    }
}

/// `/torque/nominal` → `torque_nominal`; the details of a topic belong to it.
fn stem_of(topic: &MessageTopic) -> String {
    base_of(topic).trim_matches('/').replace('/', "_")
}

/// `/smoothed/detail` → `/smoothed`, where it is one of ours.
pub(crate) fn base_of(topic: &MessageTopic) -> &str {
    let ours = [MEASURED, MOTION].contains(&topic.schema.as_str());
    topic.name.strip_suffix("/detail").filter(|_| ours).unwrap_or(&topic.name)
}

fn kind_of(leaf: &Leaf) -> Option<Kind> {
    Some(match leaf.primitive {
        Primitive::Text => return None,
        Primitive::F32 | Primitive::F64 => Kind::Float,
        Primitive::Bool => Kind::Flag,
        _ => Kind::Integer,
    })
}
