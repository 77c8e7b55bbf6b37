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
    let unit = position_unit(usual_reach(&positions));
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

/// What most of the columns reach: one of them may have a spike.
fn usual_reach(columns: &[&Column]) -> f64 {
    let mut reaches: Vec<f64> =
        columns.iter().filter_map(|c| c.range).map(|(low, high)| low.abs().max(high.abs())).collect();
    reaches.sort_by(f64::total_cmp);
    reaches.get(reaches.len().saturating_sub(1) / 2).copied().unwrap_or(0.0)
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

/// A line, if values up to `reach` are hardly radians.
fn position_unit(reach: f64) -> Option<String> {
    let shown = significant(reach, 4);
    if reach > 1e4 {
        return Some(format!(
            "# they reach {shown}: encoder counts? then position_scale = 2 pi / counts per joint turn"
        ));
    }
    // Two turns in radians are 12.6; a joint that turns on and on may have more.
    (reach > 4.0 * std::f64::consts::PI).then(|| format!("position_unit = \"deg\"  # they reach {shown}"))
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

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(text: &str) -> Vec<String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.csv");
        std::fs::write(&path, text).unwrap();
        match lacuna_recording::survey(&path).unwrap() {
            Some(lacuna_recording::Survey::Table(table)) => mapping(&table),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_table_of_others_is_guessed_at_and_the_guess_reads_it() {
        let text =
            "Timestamp;Axis1.ActPos;Axis1.SetPos;Axis1.Trq [Nm]\n1000;-170,5;0;1\n1001;-171;0;2\n1002;-172;0;3\n";
        let found = lines(text);
        let expected = [
            "time = \"Timestamp\"",
            "time_unit = \"ms\"  # its median step is 1.000",
            "position = [\"Axis1.ActPos\"]",
            "position_unit = \"deg\"  # they reach 172.0",
            "torque = [\"Axis1.Trq [Nm]\"]",
        ];
        assert_eq!(found, expected);
        let robot =
            format!("kind = \"serial\"\nname = \"r\"\njoints = [\"a\"]\n[[dh]]\n[columns]\n{}\n", found.join("\n"));
        let robot = lacuna_interfaces::RobotFile::parse(&robot).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.csv");
        std::fs::write(&path, text).unwrap();
        let read = lacuna_recording::read_all(&path, &robot).unwrap();
        assert_eq!((read.t_s[2], read.tau_nm[0][2]), (1.002, 3.0));
        assert!((read.q_rad[0][0].to_degrees() + 170.5).abs() < 1e-12);
    }

    #[test]
    fn usual_names_need_no_line() {
        assert!(lines("t,q1,q2,tau1,tau2\n0,1,2,3,4\n0.001,1,2,3,4\n0.002,1,2,3,4\n").is_empty());
        // One spike is no unit; a motor map without a time has none.
        assert!(lines("t,q1,q2,tau1,tau2\n0,1,2,3,4\n0.001,1,55,3,4\n0.002,1,2,3,4\n").is_empty());
        assert!(lines("q1,tau1\n0,1\n0.1,2\n0.2,3\n0.3,1\n").is_empty());
        assert_eq!(lines("t,q1,tau1\n0,170,3\n0.001,160,3\n").len(), 2);
    }
}
