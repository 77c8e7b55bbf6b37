//! A guess at the `[columns]` of a robot file that would let a table of others be read, from names and values; a proposal
//! for the user to correct, never used by itself.

use lacuna_recording::Table;
use lacuna_recording::survey::Column;
use lacuna_report::number::significant;

/// Lines below `[columns]`; empty if the table has the usual names, or nothing is recognised.
pub fn mapping(table: &Table) -> Vec<String> {
    let usual = |prefix: &str| table.columns.iter().any(|c| is_usual(prefix, &c.name));
    let mut lines = Vec::new();
    if let Some(time) = table.time.and_then(|i| table.columns.get(i)) {
        lines.extend(time_lines(time));
    }
    let signals = |word: fn(&str) -> bool| -> Vec<&Column> {
        let all = table.columns.iter().filter(|c| c.numbers > 0 && word(&c.name.to_ascii_lowercase()));
        all.collect()
    };
    let (positions, torques) = (signals(is_position), signals(is_torque));
    let list = |columns: &[&Column]| columns.iter().map(|c| quoted(&c.name)).collect::<Vec<_>>().join(", ");
    let largest = |columns: &[&Column]| {
        columns.iter().filter_map(|c| c.range).fold(0.0_f64, |most, (low, high)| most.max(low.abs()).max(high.abs()))
    };
    let unit = position_unit(largest(&positions));
    if !positions.is_empty() && (!usual("q") || unit.is_some()) {
        lines.push(format!("position = [{}]", list(&positions)));
        lines.extend(unit);
    }
    if !torques.is_empty() && !usual("tau") {
        lines.push(format!("torque = [{}]", list(&torques)));
        if torques.iter().any(|c| is_current(&c.name.to_ascii_lowercase())) {
            lines.push("# currents: torque_scale, or torque_unit = \"A\" at the head of the robot file".to_owned());
        }
    }
    lines
}

/// TOML, whatever the name holds.
fn quoted(name: &str) -> String {
    toml::Value::String(name.to_owned()).to_string()
}

fn is_usual(prefix: &str, name: &str) -> bool {
    let rest = name.strip_prefix(prefix);
    rest.is_some_and(|r| r.starts_with('_') || (!r.is_empty() && r.bytes().all(|b| b.is_ascii_digit())))
}

/// The time's name and unit, where they are not `t` and seconds.
fn time_lines(column: &Column) -> Vec<String> {
    let step = column.steps.median().unwrap_or(0.0);
    let name = column.name.to_ascii_lowercase();
    let ends = |unit: &str| name.ends_with(&format!("_{unit}")) || name.contains(&format!("[{unit}]"));
    // Robots are sampled at 20 Hz to 20 kHz.
    let (unit, by_name) = match () {
        () if ends("s") || ends("sec") => ("s", true),
        () if ends("ms") => ("ms", true),
        () if ends("us") || ends("µs") => ("us", true),
        () if ends("ns") => ("ns", true),
        () if step >= 5e4 => ("ns", false),
        () if step >= 50.0 => ("us", false),
        () if step >= 0.05 => ("ms", false),
        () => ("s", false),
    };
    if column.name == "t" && unit == "s" {
        return Vec::new();
    }
    let mut lines = vec![format!("time = {}", quoted(&column.name))];
    if unit != "s" {
        let why = if by_name { String::new() } else { format!("  # its median step is {}", significant(step, 4)) };
        lines.push(format!("time_unit = \"{unit}\"{why}"));
    }
    lines
}

/// A line, if values up to `largest` are hardly radians.
fn position_unit(largest: f64) -> Option<String> {
    let shown = significant(largest, 4);
    if largest > 1e4 {
        return Some(format!(
            "# they reach {shown}: encoder counts? then position_scale = 2 pi / counts per joint turn"
        ));
    }
    // Two turns in radians are 12.6; a joint that turns on and on may have more.
    (largest > 4.0 * std::f64::consts::PI).then(|| format!("position_unit = \"deg\"  # they reach {shown}"))
}

fn is_of_others(name: &str) -> bool {
    let words = ["vel", "speed", "acc", "cmd", "command", "des", "ref", "target", "set", "err", "temp", "link", "sd_"];
    words.iter().any(|w| name.contains(w))
}

fn is_position(name: &str) -> bool {
    let words = ["pos", "angle", "theta"];
    (words.iter().any(|w| name.contains(w)) || is_usual("q", name)) && !is_of_others(name) && !is_torque(name)
}

fn is_torque(name: &str) -> bool {
    let words = ["torque", "trq", "effort", "moment"];
    (words.iter().any(|w| name.contains(w)) || is_usual("tau", name) || is_current(name)) && !is_of_others(name)
}

fn is_current(name: &str) -> bool {
    name.contains("current") || name.starts_with("iq") || name.contains("_iq")
}
