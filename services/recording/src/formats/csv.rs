//! CSV: a header line, then one row per sample.
//!
//! | column | meaning |
//! |---|---|
//! | `t` | time [s]; exact to the nanosecond as written |
//! | `q1`…`qn` or `q_<joint>` | positions [rad] |
//! | `tau1`…`taun` or `tau_<joint>` | torques, in the robot file's `torque_unit` |
//! | those named in the robot file's `[columns]` | temperature, drive enabled, link-side position and torque |
//! | `temp1`…`tempn` | temperatures [°C], unless `[columns]` names others |
//! | `x_*` | further signals; an empty cell or `nan` is NaN |
//! | any other | not read, but listed |
//!
//! The delimiter is `,`, `;` or a tab, whichever the header holds. Names may be padded or quoted; a byte order
//! mark, CRLF, empty lines and trailing delimiters are accepted. A last row without a newline that is short
//! or ends in half a number was cut off in mid-write: dropped and counted. If what remains of its last number
//! still reads as a number it cannot be told from a whole row, and is kept.
//!
//! Rows are split here and not by the `csv` crate: that one has no bound on a row's length, and places an error
//! at the blank lines before a row instead of at the row.

use super::rows::{Lines, Row, bare, parse_number};
use super::{Format, Request};
use crate::condition::{MAX_TIME_S, repair};
use crate::files::open_error;
use crate::sample::{About, RawReader, Sample};
use lacuna_interfaces::{BadInput, Joints, MAX_JOINTS, Repair, RepairKind, RobotFile, flag};
use std::fs::File;
use std::io::Read;

/// The registry's line.
pub const FORMAT: Format = Format { name: "csv", extensions: &["csv", "tsv", "txt"], exact: true, sniff: None, open };

fn open(request: &Request<'_>) -> Result<Box<dyn RawReader>, BadInput> {
    let file = File::open(request.path).map_err(|e| open_error(request.path, &e))?;
    Ok(Box::new(CsvReader::new(file, request.robot, request.options.extra)?))
}

/// Reads CSV from any byte source.
pub(crate) struct CsvReader<R> {
    lines: Lines<R>,
    row: Row,
    columns: Columns,
    about: About,
    truncated: u64,
}

/// Which column holds what.
#[derive(Debug, Default)]
struct Columns {
    /// All header names, for messages; trailing empty ones left out.
    names: Vec<String>,
    t: usize,
    q: Vec<usize>,
    tau: Vec<usize>,
    temperature: Vec<usize>,
    link_q: Vec<usize>,
    link_tau: Vec<usize>,
    enabled: Option<usize>,
    extra: Vec<usize>,
}

impl<R: Read + Send> CsvReader<R> {
    pub(crate) fn new(source: R, robot: &RobotFile, extra: bool) -> Result<Self, BadInput> {
        let mut lines = Lines::new(source);
        let mut row = Row::default();
        if !row.read(&mut lines)? {
            return Err(BadInput::new("found an empty file; expected a header line with t, q1…, tau1…").at_line(1));
        }
        let (columns, about) = Columns::find(&row, robot, extra).map_err(|e| e.at_line(lines.line))?;
        Ok(Self { lines, row, columns, about, truncated: 0 })
    }
}

impl<R: Read + Send> RawReader for CsvReader<R> {
    fn about(&self) -> &About {
        &self.about
    }

    fn next_sample(&mut self, out: &mut Sample) -> Result<bool, BadInput> {
        if !self.row.read(&mut self.lines)? {
            return Ok(false);
        }
        match self.columns.fill(&self.row, out) {
            Ok(()) => Ok(true),
            Err(_) if !self.lines.terminated && self.row.looks_cut(self.columns.names.len()) => {
                self.truncated += 1;
                Ok(false)
            }
            Err(error) => Err(self.locate(error)),
        }
    }

    fn locate(&self, error: BadInput) -> BadInput {
        error.at_line(self.lines.line)
    }

    fn bytes_read(&self) -> u64 {
        self.lines.used()
    }

    fn repairs(&self) -> Vec<Repair> {
        let cut = repair(RepairKind::TruncatedTail, "t", self.truncated);
        Vec::from_iter((cut.count > 0).then_some(cut))
    }
}

impl Columns {
    fn find(header: &Row, robot: &RobotFile, extra: bool) -> Result<(Self, About), BadInput> {
        let mut names: Vec<String> = header.fields().map(|f| String::from_utf8_lossy(bare(f)).into_owned()).collect();
        while names.last().is_some_and(String::is_empty) {
            names.pop();
        }
        if let Some(i) = (0..names.len()).find(|&i| names[..i].contains(&names[i])) {
            return Err(BadInput::new(format!("found column \"{}\" twice; expected distinct columns", names[i])));
        }
        let mut found = Self { names, ..Self::default() };
        found.signals(robot)?;
        let listed = |list: &[String]| list.iter().map(|name| found.named(name)).collect::<Result<Vec<_>, _>>();
        let columns = &robot.columns;
        let temperature = if columns.temperature.is_empty() {
            // By default all joints or none: a lone temp1 on a three-joint robot is of an unknown joint.
            let all: Option<Vec<_>> = (1..=robot.joint_count()).map(|j| found.at(&format!("temp{j}"))).collect();
            all.unwrap_or_default()
        } else {
            listed(&columns.temperature)?
        };
        let link_q = listed(&columns.link_position)?;
        let link_tau = listed(&columns.link_torque)?;
        let enabled = columns.enabled.as_deref().map(|name| found.named(name)).transpose()?;
        found.temperature = temperature;
        found.link_q = link_q;
        found.link_tau = link_tau;
        found.enabled = enabled;
        let about = found.about(extra);
        Ok((found, about))
    }

    /// Finds time, positions and torques.
    fn signals(&mut self, robot: &RobotFile) -> Result<(), BadInput> {
        let mut missing = Vec::new();
        match self.at("t") {
            Some(t) => self.t = t,
            None => missing.push("t".to_owned()),
        }
        for (prefix, into) in [("q", true), ("tau", false)] {
            let mut list = Vec::new();
            for (j, joint) in robot.joints.iter().enumerate() {
                let (by_number, by_name) = (format!("{prefix}{}", j + 1), format!("{prefix}_{joint}"));
                match (self.at(&by_number), self.at(&by_name)) {
                    (Some(_), Some(_)) => {
                        return Err(BadInput::new(format!(
                            "found both \"{by_number}\" and \"{by_name}\"; expected one column for joint {joint}"
                        )));
                    }
                    (Some(i), None) | (None, Some(i)) => list.push(i),
                    (None, None) => missing.push(by_number),
                }
            }
            let beyond = format!("{prefix}{}", robot.joint_count() + 1);
            if missing.is_empty() && self.at(&beyond).is_some() {
                return Err(BadInput::new(format!(
                    "found column \"{beyond}\"; expected {} joints, as many as robot \"{}\" has",
                    robot.joint_count(),
                    robot.name
                )));
            }
            *(if into { &mut self.q } else { &mut self.tau }) = list;
        }
        if missing.is_empty() {
            return Ok(());
        }
        Err(BadInput::new(format!(
            "found columns {}; expected also {} for robot \"{}\" with joints {}",
            shortened(&self.names),
            missing.join(", "),
            robot.name,
            robot.joints.join(", ")
        )))
    }

    fn at(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|n| n == name)
    }

    /// A column that the robot file names.
    fn named(&self, name: &str) -> Result<usize, BadInput> {
        self.at(name).ok_or_else(|| {
            BadInput::new(format!("found no column \"{name}\"; expected it, since the robot file's [columns] names it"))
        })
    }

    /// Sorts the columns beyond time, positions and torques into those that are handed over and the rest.
    fn about(&mut self, extra: bool) -> About {
        let mut about = About { format: FORMAT.name, ..About::default() };
        for (i, name) in self.names.iter().enumerate() {
            let signal = i == self.t || self.q.contains(&i) || self.tau.contains(&i);
            let special = [&self.temperature, &self.link_q, &self.link_tau].iter().any(|list| list.contains(&i))
                || self.enabled == Some(i);
            if !signal && (special || name.starts_with("x_")) {
                if extra {
                    about.extra_names.push(name.clone());
                    self.extra.push(i);
                }
            } else if !signal {
                about.ignored.push(name.clone());
            }
        }
        about
    }

    fn fill(&self, row: &Row, out: &mut Sample) -> Result<(), BadInput> {
        let width = self.names.len();
        if row.len() < width || row.fields().skip(width).any(|f| !bare(f).is_empty()) {
            return Err(BadInput::new(format!("found {} fields; expected {width}, as in the header", row.len())));
        }
        let m = &mut out.measured;
        let t = self.field(row, self.t);
        m.header.stamp_ns = parse_ns(t).ok_or_else(|| self.not_a(row, self.t, "a time in seconds"))?;
        self.list(row, &self.q, &mut m.q_rad)?;
        self.list(row, &self.tau, &mut m.tau_nm)?;
        for (from, to) in [
            (&self.temperature, &mut m.temperature_degc),
            (&self.link_q, &mut m.link_q_rad),
            (&self.link_tau, &mut m.link_tau_nm),
        ] {
            *to = [f64::NAN; MAX_JOINTS];
            self.list(row, from, to)?;
        }
        if let Some(i) = self.enabled
            && self.number(row, i)? < 0.5
        {
            m.header.flags |= flag::DRIVE_OFF;
        }
        out.extra.clear();
        for &i in &self.extra {
            let field = self.field(row, i);
            let value = if field.is_empty() { Some(f64::NAN) } else { parse_number(field) };
            out.extra.push(value.ok_or_else(|| self.not_a(row, i, "a number"))?);
        }
        Ok(())
    }

    fn list(&self, row: &Row, from: &[usize], to: &mut Joints) -> Result<(), BadInput> {
        for (&i, slot) in from.iter().zip(to) {
            *slot = self.number(row, i)?;
        }
        Ok(())
    }

    fn number(&self, row: &Row, i: usize) -> Result<f64, BadInput> {
        let value = parse_number(self.field(row, i)).filter(|v| v.is_finite());
        value.ok_or_else(|| self.not_a(row, i, "a finite number"))
    }

    fn field<'a>(&self, row: &'a Row, i: usize) -> &'a [u8] {
        row.get(i).map_or(&[], bare)
    }

    fn not_a(&self, row: &Row, i: usize, expected: &str) -> BadInput {
        let text = String::from_utf8_lossy(self.field(row, i));
        let text: String = text.chars().take(40).filter(|c| !c.is_control()).collect();
        let name = self.names.get(i).map_or("", String::as_str);
        BadInput::new(format!("found \"{text}\" in column {name}; expected {expected}"))
    }
}

fn shortened(names: &[String]) -> String {
    let shown: Vec<String> = names.iter().take(12).map(|n| n.chars().take(40).collect()).collect();
    let rest = names.len().saturating_sub(shown.len());
    let list = shown.join(", ");
    if rest > 0 { format!("{list} and {rest} more") } else { list }
}

/// Seconds to nanoseconds without passing through f64, which would lose the nanoseconds of times since 1970.
/// Numbers with an exponent do pass through it.
fn parse_ns(field: &[u8]) -> Option<i64> {
    let (negative, digits) = match field {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, field),
    };
    let dot = digits.iter().position(|&b| b == b'.').unwrap_or(digits.len());
    let (whole, part) = digits.split_at(dot);
    let part = part.get(1..).unwrap_or(&[]);
    let plain = whole.len() + part.len() > 0 && whole.iter().chain(part).all(u8::is_ascii_digit);
    if !plain || whole.len() > 10 {
        // Out-of-range seconds saturate here and are then refused as implausible.
        return parse_number(field).filter(|t| t.is_finite()).map(|t| (t * 1e9).round() as i64);
    }
    let number = |list: &[u8]| list.iter().fold(0_i64, |n, b| n * 10 + i64::from(b - b'0'));
    let seconds = number(whole).min(MAX_TIME_S + 1);
    let nanos = (0..9).fold(0_i64, |n, k| n * 10 + part.get(k).map_or(0, |b| i64::from(b - b'0')));
    let round_up = i64::from(part.get(9).is_some_and(|&b| b >= b'5'));
    let ns = seconds * 1_000_000_000 + nanos + round_up;
    Some(if negative { -ns } else { ns })
}
