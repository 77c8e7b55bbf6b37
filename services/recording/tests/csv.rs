//! CSV as people write it.

mod common;

use lacuna_interfaces::{BadInput, Recording, RepairKind, RobotFile};
use lacuna_recording::{open, read_all};

fn one_joint() -> RobotFile {
    RobotFile::parse("kind = \"serial\"\nname = \"r\"\njoints = [\"servo\"]\n[[dh]]\n").unwrap()
}

fn read(text: impl AsRef<[u8]>) -> Result<Recording, BadInput> {
    read_with(text, &one_joint())
}

fn read_with(text: impl AsRef<[u8]>, robot: &RobotFile) -> Result<Recording, BadInput> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("r.csv");
    std::fs::write(&path, text).unwrap();
    read_all(&path, robot)
}

#[test]
fn dialects_mean_the_same() {
    let plain = read("t,q1,tau1,x_a\n0,1.5,-2,7\n0.001,1.25,-3,8\n").unwrap();
    assert_eq!((plain.t_s.as_slice(), plain.q_rad[0].as_slice()), (&[0.0, 0.001][..], &[1.5, 1.25][..]));
    assert_eq!((plain.tau_nm[0].as_slice(), plain.extra["x_a"].as_slice()), (&[-2.0, -3.0][..], &[7.0, 8.0][..]));
    for dialect in [
        "  t , q1 ,tau1 , x_a \n 0 , 1.5, -2 ,7 \n 0.001,1.25,-3,8\n",
        "t,q1,tau1,x_a\r\n0,1.5,-2,7\r\n0.001,1.25,-3,8\r\n",
        "\u{feff}t,q1,tau1,x_a\n0,1.5,-2,7\n0.001,1.25,-3,8\n",
        "t,q1,tau1,x_a,\n0,1.5,-2,7,\n0.001,1.25,-3,8,\n",
        "t,q1,tau1,x_a\n0,1.5,-2,7,\n0.001,1.25,-3,8,,\n",
        "t;q1;tau1;x_a\n0;1.5;-2;7\n0.001;1.25;-3;8\n",
        "t;q1;tau1;x_a\r\n0;1,5;-2;7\r\n0,001;1,25;-3;8\r\n",
        "t\tq1\ttau1\tx_a\n0\t1.5\t-2\t7\n0.001\t1.25\t-3\t8\n",
        "\"t\",\"q1\",\"tau1\",\"x_a\"\n\"0\",1.5,-2,7\n0.001,\"1.25\",-3,8\n",
        "x_a,tau_servo,q_servo,t\n7,-2,1.5,0\n8,-3,1.25,1e-3\n",
        "t,q1,tau1,x_a\n\n0,1.5,-2,7\n\n0.001,1.25,-3,8\n\n",
        "t,q1,tau1,x_a\n0,1.5,-2,7\n0.001,1.25,-3,8",
        "t,q1,tau1,x_a\n+0.000,1.50,-2.0e0,7\n1E-3,0.125e1,-.3e1,8.\n",
    ] {
        assert_eq!(read(dialect).unwrap(), plain, "{dialect}");
    }
}

#[test]
fn errors_name_line_column_and_expectation() {
    for (text, line, expect) in [
        ("", 1, "empty file"),
        ("\n\n", 1, "empty file"),
        ("q1,tau1\n0,1\n", 1, "expected also t"),
        ("t,q1\n0,1\n", 1, "expected also tau1"),
        ("t,tau1,q2\n0,1,2\n", 1, "expected also q1"),
        ("t,q1,q2,tau1\n0,1,2,3\n", 1, "\"q2\""),
        ("t,q1,q_servo,tau1\n0,1,2,3\n", 1, "both"),
        ("t,q1,q1,tau1\n0,1,2,3\n", 1, "twice"),
        ("t,q1,tau1\n0,1,2\n0.1,abc,2\n", 3, "\"abc\" in column q1"),
        ("t,q1,tau1\n0,1,2\n0.1,,2\n", 3, "\"\" in column q1"),
        ("t,q1,tau1\n0,1,nan\n", 2, "column tau1"),
        ("t,q1,tau1\n0,1,-inf\n", 2, "column tau1"),
        ("t,q1,tau1\nx,1,2\n", 2, "column t; expected a time"),
        ("t,q1,tau1\nnan,1,2\n", 2, "column t"),
        ("t,q1,tau1\n0,1,2\n0.1,1\n0.2,1,2\n", 3, "found 2 fields; expected 3"),
        ("t,q1,tau1\n0,1,2\n0.1,1,2,9\n0.2,1,2\n", 3, "found 4 fields; expected 3"),
        ("t,q1,tau1\n0,1,2\n0.2,1,2\n0.1,1,2\n", 4, "backwards: found t = 0.1 s after 0.2 s"),
        ("t,q1,tau1\n0,1e293,2\n", 2, "q1 = 1e293"),
        ("t,q1,tau1\n1660000000000,1,2\n", 2, "ms or ns"),
        ("t,q1,tau1\n0,1,2\n1e300,1,2\n0.1,1,2\n", 3, "ms or ns"),
        ("t;q1;tau1\n0;1.001,5;2\n", 2, "\"1.001,5\""),
        ("t,q1,tau1,x_a\n0,1,2,RUN\n", 2, "\"RUN\" in column x_a"),
        ("# comment\nt,q1,tau1\n", 1, "# comment"),
    ] {
        let e = read(text).unwrap_err();
        assert_eq!(e.line, Some(line), "{text}: {e}");
        assert!(e.what.contains(expect), "{text}: {e}");
        assert!(!e.to_string().contains('\n'), "{e}");
    }
}

/// A controller's own log: its names, milliseconds, degrees and millimetres, torque at the motor, decimal commas.
#[test]
fn columns_and_units_of_others() {
    let head =
        "kind = \"serial\"\nname = \"r\"\njoints = [\"turn\", \"slide\"]\n[[dh]]\n[[dh]]\njoint = \"prismatic\"\n";
    let table = "[columns]\ntime = \"Time [ms]\"\ntime_unit = \"ms\"\nposition = [\"A1.Pos\", \"A2.Pos\"]\n\
        position_unit = [\"deg\", \"mm\"]\nposition_scale = [-1, 1]\ntorque = [\"A1.Trq\", \"A2.Trq\"]\n\
        torque_scale = [-50, 2]\nreference = [\"A1.Cmd\"]\n";
    let robot = RobotFile::parse(&format!("{head}{table}")).unwrap();
    let text = "Time [ms];A1.Pos;A1.Trq;A2.Pos;A2.Trq;A1.Cmd;Mode\n1700000000000,125;90;0,5;250;-3;180;1\n\
        1700000000001,125;-45;1;251;-4;0;1\n";
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("r.csv");
    std::fs::write(&path, text).unwrap();
    let mut reader = open(&path, &robot).unwrap();
    assert_eq!(reader.about().ignored, ["Mode"]);
    let m = reader.next_sample().unwrap().unwrap().measured;
    assert_eq!(m.header.stamp_ns, 1_700_000_000_000_125_000, "to the nanosecond");
    use std::f64::consts::{FRAC_PI_2, PI};
    let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-15, "{a} {b}");
    close(m.q_rad[0], -FRAC_PI_2);
    close(m.q_rad[1], 0.25);
    assert_eq!(m.tau_nm[..2], [-25.0, -6.0]);
    let whole = read_with(text, &robot).unwrap();
    close(whole.extra["A1.Cmd"][0], PI);
    // A table with the usual names is in the usual units, whatever the robot file says of others.
    let usual = read_with("t,q1,q_slide,tau1,tau2\n0.001,1,2,3,4\n", &robot).unwrap();
    assert_eq!((usual.t_s[0], usual.q_rad[0][0], usual.q_rad[1][0], usual.tau_nm[0][0]), (0.001, 1.0, 2.0, 3.0));
    let e = read_with("Time [ms];A1.Pos;A1.Trq;A2.Trq\n0;1;2;3\n", &robot).unwrap_err();
    assert!(e.what.contains("expected also A2.Pos for robot"), "{e}");
    for (unit, cell, ns) in [
        ("s", "1700000000.000000125", 1_700_000_000_000_000_125),
        ("us", "1700000000000000.125", 1_700_000_000_000_000_125),
        ("ns", "1700000000000000125", 1_700_000_000_000_000_125),
        ("ns", "-125", -125),
        ("ms", "1e3", 1_000_000_000),
    ] {
        let robot = RobotFile::parse(&format!("{head}{}", table.replace("\"ms\"", &format!("\"{unit}\"")))).unwrap();
        std::fs::write(&path, format!("Time [ms];A1.Pos;A1.Trq;A2.Pos;A2.Trq\n{cell};0;0;0;0\n")).unwrap();
        let stamp = open(&path, &robot).unwrap().next_sample().unwrap().unwrap().measured.header.stamp_ns;
        assert_eq!(stamp, ns, "{cell} {unit}");
    }
    let late = RobotFile::parse(&format!("{head}{}", table.replace("time_unit = \"ms\"\n", ""))).unwrap();
    let e = read_with("Time [ms];A1.Pos;A1.Trq;A2.Pos;A2.Trq\n1700000000000;0;0;0;0\n", &late).unwrap_err();
    assert!(e.what.contains("ms or ns"), "{e}");
}

#[test]
fn lines_count_over_blank_ones_and_crlf() {
    let e = read("\r\nt,q1,tau1\r\n\r\n0,1,2\r\n\r\n0.1,x,2\r\n").unwrap_err();
    assert_eq!(e.line, Some(6), "{e}");
}

#[test]
fn a_tail_cut_in_mid_write_is_dropped_and_counted() {
    for tail in ["0.2", "0.2,", "0.2,1.0", "0.2,1.0,", "0.2,1.0,-", "0.2,1.0,1e", "0.", "\0\0\0\0"] {
        let r = read(format!("t,q1,tau1\n0,1,2\n0.1,1,2\n{tail}")).unwrap();
        assert_eq!(r.len(), 2, "{tail}");
        assert_eq!(r.repairs.len(), 1);
        assert_eq!((r.repairs[0].kind, r.repairs[0].count), (RepairKind::TruncatedTail, 1));
        assert_eq!(r.repairs[0].file, "r.csv");
    }
    // A whole row with text in its middle is not cut but wrong.
    assert_eq!(read("t,q1,tau1\n0,1,2\n0.1,abc,2").unwrap_err().line, Some(3));
    // With a newline behind it, the same row is not cut but wrong.
    assert_eq!(read("t,q1,tau1\n0,1,2\n0.1,1,2\n0.2,1.0\n").unwrap_err().line, Some(4));
}

#[test]
fn temperatures_default_names_and_gaps_in_x_columns() {
    let r = read("t,q1,tau1,temp1,x_a,other\n0,1,2,25.5,,text\n0.1,1,2,26,nan,text\n").unwrap();
    assert_eq!(r.extra["temp1"], [25.5, 26.0]);
    assert!(r.extra["x_a"].iter().all(|v| v.is_nan()));
    assert_eq!(r.extra.len(), 2, "columns of no known kind are left out");
    assert!(read("t,q1,tau1,temp1\n0,1,2,\n").unwrap_err().what.contains("temp1"));

    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("r.csv");
    std::fs::write(&path, "t,q1,tau1,temp1,other\n0,1,2,25.5,text\n").unwrap();
    let mut reader = open(&path, &one_joint()).unwrap();
    assert_eq!(reader.about().ignored, ["other"]);
    let sample = reader.next_sample().unwrap().unwrap();
    assert_eq!(sample.measured.temperature_degc[0], 25.5);
    assert!(sample.measured.link_q_rad[0].is_nan() && sample.extra.is_empty());
}

#[test]
fn columns_of_the_robot_file_must_be_there() {
    let e = read_with("t,q1,q2,tau1,tau2,x_ta,x_tb,x_on\n0,1,2,3,4,5,6,1\n", &common::robot()).unwrap_err();
    assert!(e.what.contains("\"x_enc\"") && e.line == Some(1), "{e}");
}

#[test]
fn a_line_without_end_does_not_fill_the_memory() {
    let mut text = b"t,q1,tau1\n0,1,2\n".to_vec();
    text.resize(3 << 20, b'1');
    let e = read(&text).unwrap_err();
    assert!(e.what.contains("longer than"), "{e}");
    let e = read(vec![b'a'; 3 << 20]).unwrap_err();
    assert!(e.what.contains("longer than"), "{e}");
}
