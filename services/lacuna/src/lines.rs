//! Samples as lines of a terminal or as JSON, one a line: what `echo` and `play` print.

use lacuna_interfaces::{BadInput, JointMeasured};
use lacuna_recording::messages::Messages;
use lacuna_recording::ros::definition::{Arity, Decoded, Scalar, text_of};
use lacuna_recording::{ReadOptions, Reader};
use lacuna_stage::AnyMessage;
use lacuna_stage::Failure;
use serde_json::{Map, Value};
use std::io::{BufWriter, StdoutLock, Write};
use std::path::{Path, PathBuf};

/// A sample to be printed.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Topic.
    pub topic: String,
    /// Time of measurement [ns].
    pub stamp_ns: i64,
    /// Time that paces it when it is played [ns]: when it was recorded, or the stamp.
    pub at_ns: i64,
    /// Fields by name.
    pub fields: Vec<(String, Value)>,
}

/// A number as JSON; what is not finite is null.
fn number(value: f64) -> Value {
    serde_json::Number::from_f64(value).map_or(Value::Null, Value::Number)
}

fn list(values: &[f64]) -> Value {
    Value::Array(values.iter().map(|v| number(*v)).collect())
}

/// Lines out of a recording.
pub enum Lines {
    /// The messages of an MCAP.
    Messages(Box<MessageLines>),
    /// The samples of any recording, as read for a robot.
    Samples(Box<SampleLines>),
}

/// The messages of an MCAP.
pub struct MessageLines {
    messages: Messages,
    decoded: Decoded,
    topics: Vec<String>,
}

/// The samples of a recording.
pub struct SampleLines {
    reader: Reader,
    joints: usize,
}

impl Lines {
    /// Opens a recording: an MCAP as it stands, or with a robot file any recording.
    ///
    /// # Errors
    /// If it cannot be read, has no topic of these, or needs a robot file.
    pub fn open(recording: &Path, robot: Option<&PathBuf>, topics: &[String]) -> Result<Self, Failure> {
        if let Some(robot) = robot {
            let robot = lacuna_recording::load_robot(robot)?.file;
            let topic = match topics {
                [] => None,
                [one] => Some(one.clone()),
                _ => {
                    return Err(Failure::usage(
                        "--topics: found several with --robot; expected one, the joint signals",
                    ));
                }
            };
            let options = ReadOptions { topic, ..ReadOptions::default() };
            let reader = lacuna_recording::open_with(recording, &robot, &options)?;
            return Ok(Self::Samples(Box::new(SampleLines { reader, joints: robot.joint_count() })));
        }
        if !lacuna_recording::is_mcap(recording)? {
            let what = "found a recording without topics; expected --robot FILE, which says what its columns are";
            return Err(BadInput::new(what).in_file(recording).into());
        }
        let there = topic_names(recording)?;
        if let Some(wanted) = topics.iter().find(|t| !there.contains(t)) {
            let there: Vec<String> = there.iter().map(|t| lacuna_recording::messages::one_line(t)).collect();
            let what = format!("found topics {}; expected {wanted}", there.join(", "));
            return Err(BadInput::new(what).in_file(recording).into());
        }
        let messages = Messages::open(recording)?;
        Ok(Self::Messages(Box::new(MessageLines { messages, decoded: Decoded::default(), topics: topics.to_vec() })))
    }

    /// The next line; `None` at the end.
    ///
    /// # Errors
    /// [`BadInput`] where the recording is damaged.
    pub fn next_line(&mut self) -> Result<Option<Line>, BadInput> {
        match self {
            Self::Messages(lines) => lines.next_line(),
            Self::Samples(lines) => {
                let joints = lines.joints;
                Ok(lines.reader.next_sample()?.map(|sample| measured("measured", &sample.measured, joints)))
            }
        }
    }

    /// Whether the recording stops before its proper end; known at its end.
    pub fn was_cut(&self) -> bool {
        matches!(self, Self::Messages(lines) if lines.messages.was_cut())
    }
}

/// Topics of an MCAP.
///
/// # Errors
/// [`BadInput`] if it cannot be read.
pub fn topic_names(recording: &Path) -> Result<Vec<String>, BadInput> {
    lacuna_recording::container::topics(&lacuna_recording::file_of(recording)?)
}

impl MessageLines {
    fn next_line(&mut self) -> Result<Option<Line>, BadInput> {
        while let Some(message) = self.messages.next_message()? {
            let Some(topic) = self.messages.topic(message.topic) else { continue };
            if !self.topics.is_empty() && !self.topics.contains(&topic.name) {
                continue;
            }
            let data = self.messages.data();
            let fields = match &topic.layout {
                Some(layout) if layout.decode(data, &mut self.decoded).is_some() => {
                    let leaves = layout.leaves().iter().enumerate();
                    // The stamp has its own place.
                    let shown = leaves.filter(|(_, l)| !layout.is_stamped() || !l.path.starts_with("header."));
                    let value = |i: usize, arity: Arity| values(self.decoded.of(i), arity, data);
                    shown.map(|(i, l)| (l.path.clone(), value(i, l.arity))).collect()
                }
                // Of another encoding, with lists of messages, a picture: told by its size.
                _ => vec![
                    ("schema".to_owned(), Value::from(topic.schema.as_str())),
                    ("undecoded_bytes".to_owned(), Value::from(data.len())),
                ],
            };
            let at_ns = i64::try_from(message.log_time_ns).unwrap_or(i64::MAX);
            return Ok(Some(Line { topic: topic.name.clone(), stamp_ns: message.stamp_ns, at_ns, fields }));
        }
        Ok(None)
    }
}

fn values(scalars: &[Scalar], arity: Arity, data: &[u8]) -> Value {
    let one = |s: &Scalar| match *s {
        Scalar::Bool(b) => Value::from(b),
        Scalar::Int(i) => Value::from(i),
        Scalar::UInt(u) => Value::from(u),
        Scalar::Float(v) => number(v),
        text @ Scalar::Text { .. } => Value::from(text_of(data, text).unwrap_or_default()),
    };
    match (arity, scalars) {
        (Arity::One, [single]) => one(single),
        _ => Value::Array(scalars.iter().map(one).collect()),
    }
}

fn measured(topic: &str, m: &JointMeasured, n: usize) -> Line {
    let mut fields = vec![
        ("q_rad".to_owned(), list(m.q_rad.get(..n).unwrap_or(&[]))),
        ("tau_nm".to_owned(), list(m.tau_nm.get(..n).unwrap_or(&[]))),
    ];
    for (name, values) in
        [("temperature_degc", &m.temperature_degc), ("link_q_rad", &m.link_q_rad), ("link_tau_nm", &m.link_tau_nm)]
    {
        let values = values.get(..n).unwrap_or(&[]);
        if values.iter().any(|v| !v.is_nan()) {
            fields.push((name.to_owned(), list(values)));
        }
    }
    fields.push(("flags".to_owned(), Value::from(m.header.flags)));
    let stamp_ns = m.header.stamp_ns;
    Line { topic: topic.to_owned(), stamp_ns, at_ns: stamp_ns, fields }
}

/// A sample from the bus.
pub fn of_message(topic: &str, message: AnyMessage<'_>) -> Line {
    let header = message.header();
    let n = (header.joints as usize).min(lacuna_interfaces::MAX_JOINTS);
    let per_joint = |fields: &[(&str, &[f64])]| -> Vec<(String, Value)> {
        fields.iter().map(|(name, values)| ((*name).to_owned(), list(values.get(..n).unwrap_or(&[])))).collect()
    };
    let mut fields = vec![("seq".to_owned(), Value::from(header.seq))];
    match message {
        AnyMessage::JointMeasured(m) => {
            let mut line = measured(topic, m, n);
            fields.append(&mut line.fields);
            line.fields = fields;
            return line;
        }
        AnyMessage::JointSmoothed(m) => {
            fields.extend(per_joint(&[("q_rad", &m.q_rad), ("qd_rad_s", &m.qd_rad_s), ("qdd_rad_s2", &m.qdd_rad_s2)]));
        }
        AnyMessage::TorqueModel(m) => {
            fields.extend(per_joint(&[("tau_nominal_nm", &m.tau_nominal_nm), ("tau_rigid_nm", &m.tau_rigid_nm)]));
        }
        AnyMessage::FrictionTorque(m) => fields.extend(per_joint(&[("tau_friction_nm", &m.tau_friction_nm)])),
        AnyMessage::PayloadEstimate(m) => {
            let lists: [(&str, &[f64]); 2] =
                [("residual_nm", &m.residual_nm), ("residual_payload_nm", &m.residual_payload_nm)];
            fields.extend(per_joint(&lists));
            fields.push(("mass_kg".to_owned(), number(m.mass_kg)));
            fields.push(("sd_mass_kg".to_owned(), number(m.sd_mass_kg)));
        }
        AnyMessage::ResidualWatch(m) => {
            fields.extend(per_joint(&[("residual_nm", &m.residual_nm), ("sd_nm", &m.sd_nm), ("score", &m.score)]));
            fields.push(("alarm".to_owned(), Value::from(m.alarm)));
            fields.push(("watched".to_owned(), Value::from(m.watched)));
        }
    }
    fields.push(("flags".to_owned(), Value::from(header.flags)));
    Line { topic: topic.to_owned(), stamp_ns: header.stamp_ns, at_ns: header.stamp_ns, fields }
}

/// Prints lines on standard output.
pub struct Printer {
    out: BufWriter<StdoutLock<'static>>,
    json: bool,
}

impl Printer {
    /// As words, or one JSON object a line.
    pub fn new(json: bool) -> Self {
        Self { out: BufWriter::new(std::io::stdout().lock()), json }
    }

    /// Prints a line; `false` if the reader has gone away (`| head`), which is not an error.
    ///
    /// # Errors
    /// If the operating system refuses, e.g. because the disk is full.
    pub fn print(&mut self, line: Line) -> Result<bool, Failure> {
        let text = if self.json { json(line) } else { words(&line) };
        let written = writeln!(self.out, "{text}");
        self.told(written)
    }

    /// Shows what was printed so far.
    ///
    /// # Errors
    /// As [`Printer::print`].
    pub fn flush(&mut self) -> Result<bool, Failure> {
        let flushed = self.out.flush();
        self.told(flushed)
    }

    fn told(&self, result: std::io::Result<()>) -> Result<bool, Failure> {
        match result {
            Ok(()) => Ok(true),
            Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(false),
            Err(e) => Err(Failure::run(format!("standard output: cannot be written: {e}"))),
        }
    }
}

/// Seconds with all digits of the stamp.
fn seconds(ns: i64) -> String {
    let (sign, ns) = (if ns < 0 { "-" } else { "" }, ns.unsigned_abs());
    format!("{sign}{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000)
}

fn json(line: Line) -> String {
    let fields: Map<String, Value> = line.fields.into_iter().collect();
    serde_json::json!({
        "topic": line.topic, "t_s": line.stamp_ns as f64 / 1e9, "stamp_ns": line.stamp_ns, "fields": fields,
    })
    .to_string()
}

fn words(line: &Line) -> String {
    let topic = lacuna_recording::messages::one_line(&line.topic);
    let mut text = format!("{topic}  t {}", seconds(line.stamp_ns));
    for (name, value) in &line.fields {
        text.push_str("  ");
        text.push_str(name);
        text.push(' ');
        match value {
            Value::Array(list) if list.is_empty() => text.push('–'),
            Value::Array(list) => text.push_str(&list.iter().map(shown).collect::<Vec<_>>().join(" ")),
            one => text.push_str(&shown(one)),
        }
    }
    text
}

fn shown(value: &Value) -> String {
    match value {
        Value::Null => "–".to_owned(),
        // A line stays a line, whatever a string holds.
        Value::String(text) => text.escape_debug().to_string(),
        Value::Number(n) if n.is_f64() => n.as_f64().map_or_else(String::new, six_digits),
        other => other.to_string(),
    }
}

/// Six significant digits, as any program reads them.
fn six_digits(value: f64) -> String {
    format!("{value:.5e}").parse::<f64>().map_or_else(|_| value.to_string(), |v| v.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_keep_their_digits_and_absent_numbers_are_told() {
        assert_eq!(seconds(1_700_000_000_000_000_001), "1700000000.000000001");
        assert_eq!(seconds(-1_500_000_000), "-1.500000000");
        let fields = vec![("q_rad".to_owned(), list(&[0.5, f64::NAN])), ("name".to_owned(), Value::from("a\nb"))];
        let line = Line { topic: "/m".to_owned(), stamp_ns: 5, at_ns: 5, fields };
        assert!(words(&line).starts_with("/m  t 0.000000005  q_rad 0.5 –"), "{}", words(&line));
        let parsed: Value = serde_json::from_str(&json(line)).unwrap();
        assert_eq!(parsed["fields"]["q_rad"], serde_json::json!([0.5, null]));
        assert_eq!((&parsed["stamp_ns"], &parsed["topic"]), (&Value::from(5), &Value::from("/m")));
    }
}
