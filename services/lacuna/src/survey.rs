//! What `lacuna info` says of a file without knowing its robot: what is in it, and what it would need.

use lacuna_recording::Survey;
use lacuna_report::number::significant;
use serde::Serialize;
use std::fmt::Write as _;

/// What `--json` prints.
#[derive(Debug, Serialize)]
pub struct Surveyed {
    #[serde(skip_serializing_if = "Vec::is_empty")]
    columns: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rows: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    frames: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ethercat_frames: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    duration_s: Option<f64>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    datagrams: Vec<Datagram>,
    needs: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Datagram {
    command: &'static str,
    /// Logical address; of a station command the memory offset.
    address: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    station: Option<u32>,
    bytes: usize,
    copies: u64,
    returned: u64,
    working_counter: u16,
    #[serde(skip_serializing_if = "Option::is_none")]
    rate_hz: Option<f64>,
}

/// Puts a survey in the form that is printed.
pub fn survey_of(survey: &Survey) -> Surveyed {
    let mut out = Surveyed {
        columns: Vec::new(),
        rows: None,
        frames: None,
        ethercat_frames: None,
        duration_s: None,
        datagrams: Vec::new(),
        needs: Vec::new(),
    };
    match survey {
        Survey::Table(table) => {
            out.needs = needs(&table.columns);
            out.columns.clone_from(&table.columns);
            out.rows = Some(table.rows);
        }
        Survey::Bus(bus) => {
            out.frames = Some(bus.frames);
            out.ethercat_frames = Some(bus.ethercat);
            out.duration_s = bus.stamps_ns.map(|(first, last)| (last - first) as f64 / 1e9);
            let rate = |n: u64| out.duration_s.filter(|d| *d > 0.0).map(|d| n.saturating_sub(1) as f64 / d);
            out.datagrams = bus
                .datagrams
                .iter()
                .map(|d| {
                    let logical = d.command.logical();
                    Datagram {
                        command: d.command.name(),
                        address: if logical { d.address } else { d.address >> 16 },
                        station: (!logical).then_some(d.address & 0xFFFF),
                        bytes: d.bytes,
                        copies: d.copies,
                        returned: d.returned,
                        working_counter: d.working_counter,
                        rate_hz: rate(d.returned),
                    }
                })
                .collect();
            out.needs = if bus.ethercat == 0 {
                vec!["EtherCAT frames (type 0x88A4); there are none".to_owned()]
            } else {
                vec![
                    "a robot file whose [ethercat] says where position (0x6064) and torque (0x6077) of each joint are: \
                     eni = \"…\" of the master, or addresses"
                        .to_owned(),
                    "[drive] gear_ratio, encoder_bits and rated_torque_nm in it, to turn counts into rad and Nm".to_owned(),
                ]
            };
        }
    }
    out
}

/// What a table lacks or a robot file must say.
fn needs(columns: &[String]) -> Vec<String> {
    let has = |name: &str| columns.iter().any(|c| c == name);
    let numbered = |prefix: &str| (1..).take_while(|j| has(&format!("{prefix}{j}"))).count();
    let named = |prefix: &str| columns.iter().filter(|c| c.starts_with(&format!("{prefix}_"))).count();
    let (q, tau) = (numbered("q") + named("q"), numbered("tau") + named("tau"));
    let mut all = Vec::new();
    if !has("t") {
        all.push("a column t, the time in seconds".to_owned());
    }
    if q == 0 {
        all.push("columns q1…qn or q_<joint>, positions in rad".to_owned());
    }
    if tau == 0 {
        all.push("columns tau1…taun or tau_<joint>, torques".to_owned());
    }
    if q != tau && q > 0 && tau > 0 {
        all.push(format!("as many torques as positions (found {tau} and {q})"));
    }
    let joints = if q > 0 { format!(" with {q} joints") } else { String::new() };
    all.push(format!("a robot file{joints}: --robot FILE shows its signals"));
    all
}

/// In words.
pub fn survey_words(s: &Surveyed) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    if let Some(rows) = s.rows {
        let _ = writeln!(text, "CSV: {rows} rows of {}", s.columns.join(", "));
    }
    if let (Some(frames), Some(ethercat)) = (s.frames, s.ethercat_frames) {
        let length = s.duration_s.map_or_else(String::new, |d| format!(" in {} s", significant(d, 4)));
        let _ = writeln!(text, "Capture: {frames} frames{length}, {ethercat} of them EtherCAT");
    }
    if !s.datagrams.is_empty() {
        let _ = writeln!(text, "Command  Address                 Bytes  Counter  Came back      Rate");
    }
    for d in &s.datagrams {
        let address = match d.station {
            Some(station) => format!("station {station}, {:#06x}", d.address),
            None => format!("{:#010x}", d.address),
        };
        let rate = d.rate_hz.map_or_else(|| "–".to_owned(), |r| format!("{} Hz", significant(r, 4)));
        let (counter, back) = (d.working_counter, d.returned);
        let _ = writeln!(text, "{:7}  {address:22}  {:>5}  {counter:>7}  {back:>9}  {rate:>8}", d.command, d.bytes);
    }
    for need in &s.needs {
        let _ = writeln!(text, "Needs {need}");
    }
    text
}
