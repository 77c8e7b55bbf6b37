//! CSV: a header line, then one row per sample.
//!
//! | column | meaning |
//! |---|---|
//! | `t` | time [s]; exact to the nanosecond as written |
//! | `q1`…`qn` or `q_<joint>` | positions [rad] |
//! | `tau1`…`taun` or `tau_<joint>` | torques, in the robot file's `torque_unit` |
//! | those named in the robot file's `[columns]` | time, positions and torques in units of their own; temperature, drive enabled, link-side position and torque, commanded position |
//! | `temp1`…`tempn` | temperatures [°C], unless `[columns]` names others |
//! | `x_*` | further signals; an empty cell or `nan` is NaN |
//! | any other | not read, but listed |
//!
//! The delimiter is `,`, `;` or a tab, whichever the header holds. Names may be padded or quoted; a byte order
//! mark, CRLF, empty lines and trailing delimiters are accepted; where the delimiter is not a comma, a decimal comma, too. A last row without a newline that is short
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
use lacuna_interfaces::columns::TimeUnit;
use lacuna_interfaces::{BadInput, Joints, MAX_JOINTS, Repair, RepairKind, RobotFile, flag};
use std::collections::HashSet;
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
    time_unit: TimeUnit,
    q: Vec<Scaled>,
    tau: Vec<Scaled>,
    temperature: Vec<Scaled>,
    link_q: Vec<Scaled>,
    link_tau: Vec<Scaled>,
    reference: Vec<Scaled>,
    enabled: Option<usize>,
    extra: Vec<Scaled>,
}

/// A column, and what one of its unit is in ours.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Scaled {
    column: usize,
    factor: f64,
}

impl Scaled {
    fn plain(column: usize) -> Self {
        Self { column, factor: 1.0 }
    }
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
        let mut seen = HashSet::new();
        if let Some(twice) = names.iter().find(|name| !seen.insert(name.as_str())) {
            let twice: String = twice.chars().take(40).collect();
            return Err(BadInput::new(format!("found column \"{twice}\" twice; expected distinct columns")));
        }
        let mut found = Self { names, ..Self::default() };
        found.signals(robot)?;
        let columns = &robot.columns;
        let listed = |list: &[String], factor: &dyn Fn(usize) -> f64| {
            let scaled = list.iter().enumerate().map(|(j, name)| Ok((j, found.named(name)?)));
            scaled
                .map(|found| found.map(|(j, column)| Scaled { column, factor: factor(j) }))
                .collect::<Result<Vec<_>, BadInput>>()
        };
        let temperature = if columns.temperature.is_empty() {
            // By default all joints or none: a lone temp1 on a three-joint robot is of an unknown joint.
            let all: Option<Vec<_>> =
                (1..=robot.joint_count()).map(|j| found.at(&format!("temp{j}")).map(Scaled::plain)).collect();
            all.unwrap_or_default()
        } else {
            listed(&columns.temperature, &|_| 1.0)?
        };
        let link_q = listed(&columns.link_position, &|j| columns.unit_factor(j))?;
        let link_tau = listed(&columns.link_torque, &|_| 1.0)?;
        // Few recordings carry commands; what needs them says that they are missing.
        let reference = columns
            .reference
            .iter()
            .enumerate()
            .filter_map(|(j, name)| found.at(name).map(|column| Scaled { column, factor: columns.unit_factor(j) }));
        let reference = reference.collect();
        let enabled = columns.enabled.as_deref().map(|name| found.named(name)).transpose()?;
        found.temperature = temperature;
        found.link_q = link_q;
        found.link_tau = link_tau;
        found.reference = reference;
        found.enabled = enabled;
        let about = found.about(extra);
        Ok((found, about))
    }

    /// Finds time, positions and torques: the columns that the robot file names, else those of the usual names, which
    /// are in SI units whatever the robot file says of others.
    fn signals(&mut self, robot: &RobotFile) -> Result<(), BadInput> {
        let columns = &robot.columns;
        let mut missing = Vec::new();
        match (columns.time.as_deref().and_then(|name| self.at(name)), self.at("t")) {
            (Some(t), _) => (self.t, self.time_unit) = (t, columns.time_unit),
            (None, Some(t)) => self.t = t,
            (None, None) => missing.push(columns.time.clone().unwrap_or_else(|| "t".to_owned())),
        }
        self.q = match self.mapped(&columns.position, &|j| columns.position_factor(j)) {
            Some(list) => list,
            None => self.usual("q", robot, &columns.position, &mut missing)?,
        };
        self.tau = match self.mapped(&columns.torque, &|j| columns.torque_factor(j)) {
            Some(list) => list,
            None => self.usual("tau", robot, &columns.torque, &mut missing)?,
        };
        if missing.is_empty() {
            return Ok(());
        }
        Err(BadInput::new(format!(
            "found columns {}; expected also {} for robot \"{}\" with joints {} (its [columns] may name others)",
            shortened(&self.names),
            missing.join(", "),
            robot.name,
            robot.joints.join(", ")
        )))
    }

    /// The columns that the robot file names, if the file has them all.
    fn mapped(&self, names: &[String], factor: &dyn Fn(usize) -> f64) -> Option<Vec<Scaled>> {
        if names.is_empty() {
            return None;
        }
        let one = |(j, name): (usize, &String)| Some(Scaled { column: self.at(name)?, factor: factor(j) });
        names.iter().enumerate().map(one).collect()
    }

    /// The columns of the usual names: by number, or by the joint's name.
    fn usual(
        &self,
        prefix: &str,
        robot: &RobotFile,
        instead_of: &[String],
        missing: &mut Vec<String>,
    ) -> Result<Vec<Scaled>, BadInput> {
        let mut list = Vec::new();
        let mut absent = Vec::new();
        for (j, joint) in robot.joints.iter().enumerate() {
            let by_number = format!("{prefix}{}", j + 1);
            let alias = robot.columns.joints.get(j).map(|name| format!("{prefix}_{name}"));
            let mut candidates = vec![by_number.clone(), format!("{prefix}_{joint}")];
            candidates.extend(alias.filter(|a| !candidates.contains(a)));
            let there: Vec<&String> = candidates.iter().filter(|name| self.at(name).is_some()).collect();
            match there.as_slice() {
                [one] => list.extend(self.at(one).map(Scaled::plain)),
                [] => absent.push(instead_of.get(j).cloned().unwrap_or(by_number)),
                [a, b, ..] => {
                    return Err(BadInput::new(format!(
                        "found both \"{a}\" and \"{b}\"; expected one column for joint {joint}"
                    )));
                }
            }
        }
        let beyond = format!("{prefix}{}", robot.joint_count() + 1);
        if missing.is_empty() && absent.is_empty() && self.at(&beyond).is_some() {
            return Err(BadInput::new(format!(
                "found column \"{beyond}\"; expected {} joints, as many as robot \"{}\" has",
                robot.joint_count(),
                robot.name
            )));
        }
        // Of the columns that the robot file names, those that are there are not missing.
        missing.extend(absent.into_iter().filter(|name| self.at(name).is_none()));
        Ok(list)
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
            let of = |lists: &[&[Scaled]]| lists.iter().flat_map(|list| list.iter()).find(|s| s.column == i).copied();
            let signal = i == self.t || of(&[&self.q, &self.tau]).is_some();
            let special = of(&[&self.temperature, &self.link_q, &self.link_tau, &self.reference])
                .or_else(|| (self.enabled == Some(i) || name.starts_with("x_")).then(|| Scaled::plain(i)));
            if let (false, Some(column)) = (signal, special) {
                if extra {
                    about.extra_names.push(name.clone());
                    self.extra.push(column);
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
        m.header.stamp_ns = parse_ns(t, self.time_unit.decimals())
            .ok_or_else(|| self.not_a(row, self.t, time_words(self.time_unit)))?;
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
        for s in &self.extra {
            let field = self.field(row, s.column);
            let value = if field.is_empty() { Some(f64::NAN) } else { parse_number(field) };
            out.extra.push(s.factor * value.ok_or_else(|| self.not_a(row, s.column, "a number"))?);
        }
        Ok(())
    }

    fn list(&self, row: &Row, from: &[Scaled], to: &mut Joints) -> Result<(), BadInput> {
        for (s, slot) in from.iter().zip(to) {
            *slot = s.factor * self.number(row, s.column)?;
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

fn time_words(unit: TimeUnit) -> &'static str {
    match unit {
        TimeUnit::S => "a time in seconds",
        TimeUnit::Ms => "a time in milliseconds",
        TimeUnit::Us => "a time in microseconds",
        TimeUnit::Ns => "a time in nanoseconds",
    }
}

/// A time to nanoseconds, of which its unit has `decimals` places, without passing through f64, which would lose the
/// nanoseconds of times since 1970. Numbers with an exponent do pass through it.
fn parse_ns(field: &[u8], decimals: u32) -> Option<i64> {
    const LATEST_NS: u64 = (MAX_TIME_S as u64 + 1) * 1_000_000_000;
    let places = decimals as usize;
    let (negative, digits) = match field {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, field),
    };
    let dot = digits.iter().position(|&b| b == b'.').unwrap_or(digits.len());
    let (whole, part) = digits.split_at(dot);
    let part = part.get(1..).unwrap_or(&[]);
    let plain = whole.len() + part.len() > 0 && whole.iter().chain(part).all(u8::is_ascii_digit);
    if !plain || whole.len() + places > 19 {
        // Out-of-range times saturate here and are then refused as implausible.
        let value = parse_number(field).filter(|t| t.is_finite());
        return value.map(|t| (t * 10_f64.powi(decimals as i32)).round() as i64);
    }
    // At most nineteen digits: they fit.
    let places = (0..places).map(|k| part.get(k).copied().unwrap_or(b'0'));
    let ns = whole.iter().copied().chain(places).fold(0_u64, |n, b| n * 10 + u64::from(b - b'0'));
    let round_up = u64::from(part.get(decimals as usize).is_some_and(|&b| b >= b'5'));
    let ns = (ns + round_up).min(LATEST_NS) as i64;
    Some(if negative { -ns } else { ns })
}
