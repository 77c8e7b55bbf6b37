//! What every log format must do, run over every format of the registry that gives numbers back as they were written.
//! Captures, which hold counts, have tests of their own (`capture.rs`).

mod common;

use common::{motion, robot, sample, write};
use lacuna_interfaces::{BadInput, JointMeasured, RepairKind, RobotFile, flag};
use lacuna_recording::formats::FORMATS;
use lacuna_recording::{Reader, open, read_all};
use std::f64::consts::PI;
use std::path::PathBuf;

/// A file of each format with these samples.
fn files(samples: &[JointMeasured]) -> (tempfile::TempDir, Vec<PathBuf>) {
    let dir = tempfile::tempdir().unwrap();
    let paths = FORMATS.iter().filter(|f| f.exact).map(|format| {
        let path = dir.path().join(format!("log.{}", format.extensions[0]));
        write(format.name, &path, samples);
        path
    });
    let paths = paths.collect();
    (dir, paths)
}

fn drain(reader: &mut Reader) -> Result<Vec<JointMeasured>, BadInput> {
    let mut all = Vec::new();
    while let Some(sample) = reader.next_sample()? {
        all.push(sample.measured);
    }
    Ok(all)
}

fn read(path: &PathBuf) -> Result<(Vec<JointMeasured>, u64, u64, u64), BadInput> {
    let mut reader = open(path, &robot())?;
    let samples = drain(&mut reader)?;
    let count = |kind| reader.repairs().iter().filter(|r| r.kind == kind).map(|r| r.count).sum();
    Ok((samples, count(RepairKind::DuplicateStamp), count(RepairKind::Gap), count(RepairKind::Unwrapped)))
}

/// Compares bit by bit, NaN included.
fn same(a: &JointMeasured, b: &JointMeasured) -> bool {
    let bits = |m: &JointMeasured| {
        [m.q_rad, m.tau_nm, m.temperature_degc, m.link_q_rad, m.link_tau_nm].map(|list| list.map(f64::to_bits))
    };
    bits(a) == bits(b) && a.header.stamp_ns == b.header.stamp_ns && a.header.flags == b.header.flags
}

#[test]
fn samples_come_back_as_they_were_written() {
    let written = motion(3000);
    let (_dir, paths) = files(&written);
    for path in paths {
        let (samples, ..) = read(&path).unwrap();
        assert_eq!(samples.len(), written.len(), "{path:?}");
        for (k, (a, b)) in samples.iter().zip(&written).enumerate() {
            assert!(same(a, b), "{path:?} sample {k}: {a:?} {b:?}");
            assert_eq!(a.header.seq, k as u64 + 1);
            assert_eq!(a.header.joints, 2);
        }
    }
}

#[test]
fn whole_recordings_are_the_same_in_every_format() {
    let written = motion(500);
    let (_dir, paths) = files(&written);
    let all: Vec<_> = paths.iter().map(|p| read_all(p, &robot()).unwrap()).collect();
    for r in &all {
        assert_eq!(r.joints, ["shoulder", "elbow"]);
        assert_eq!(r.t_s[499], 0.499);
        assert_eq!(r.extra.keys().collect::<Vec<_>>(), ["x_enc", "x_on", "x_ta", "x_tb"]);
        assert_eq!(
            (&r.t_s, &r.q_rad, &r.tau_nm, &r.extra),
            (&all[0].t_s, &all[0].q_rad, &all[0].tau_nm, &all[0].extra)
        );
        assert!(r.repairs.is_empty());
    }
    assert_eq!(all[0].q_rad[1][7], written[7].q_rad[1]);
    assert_eq!(all[0].extra["x_on"][7], 0.0);
    assert_eq!(all[0].extra["x_on"][8], 1.0);
}

#[test]
fn times_since_1970_keep_their_nanoseconds() {
    let origin = 1_700_000_000_123_456_789;
    let written: Vec<_> = (0..100).map(|k| sample(origin + k * 250_001, 0.1, 0.2)).collect();
    let (_dir, paths) = files(&written);
    for path in paths {
        let (samples, ..) = read(&path).unwrap();
        assert!(samples.iter().zip(&written).all(|(a, b)| a.header.stamp_ns == b.header.stamp_ns));
        let whole = read_all(&path, &robot()).unwrap();
        assert_eq!((whole.t_s[0], whole.t_s[2]), (0.0, 500_002e-9), "counted from the first sample");
    }
}

#[test]
fn times_before_zero_come_back() {
    let written: Vec<_> = (-300..100).map(|k| sample(k * 1_000_000 + 1, 0.1, 0.2)).collect();
    let (_dir, paths) = files(&written);
    for path in paths {
        let (samples, ..) = read(&path).unwrap();
        assert_eq!(samples.len(), 400);
        assert!(samples.iter().zip(&written).all(|(a, b)| a.header.stamp_ns == b.header.stamp_ns), "{path:?}");
    }
}

#[test]
fn repairs_are_made_flagged_and_counted_alike() {
    let mut written = motion(100);
    written.insert(51, written[50]);
    for m in &mut written[60..] {
        m.header.stamp_ns += 40_000_000;
    }
    // Joint 2 crosses +pi at sample 80 and comes back wrapped.
    for (k, m) in written[70..].iter_mut().enumerate() {
        let q = PI - 0.1 + 0.01 * k as f64;
        m.q_rad[1] = if q > PI { q - 2.0 * PI } else { q };
    }
    let (_dir, paths) = files(&written);
    for path in paths {
        let (samples, duplicates, gaps, unwrapped) = read(&path).unwrap();
        assert_eq!((samples.len(), duplicates, gaps, unwrapped), (100, 1, 1, 1), "{path:?}");
        let flagged = |f| samples.iter().position(|m| m.header.has(f));
        assert_eq!(flagged(flag::GAP), Some(59));
        assert!(samples[99].q_rad[1] > PI);
        assert!((samples[99].q_rad[1] - (PI - 0.1 + 0.01 * 30.0)).abs() < 1e-12);
        assert_eq!(samples.iter().filter(|m| m.header.has(flag::REPAIRED)).count(), 1);
    }
}

#[test]
fn what_cannot_be_used_is_refused_with_its_place() {
    type Change = fn(&mut Vec<JointMeasured>);
    let changes: [(&str, Change); 6] = [
        ("backwards", |s| s[50].header.stamp_ns = 3),
        ("finite", |s| s[50].q_rad[1] = f64::NAN),
        ("finite", |s| s[50].tau_nm[0] = f64::INFINITY),
        ("1e293", |s| s[50].tau_nm[1] = 1e293),
        ("temperature1", |s| s[50].temperature_degc[0] = 1e30),
        ("no sample", Vec::clear),
    ];
    for (expect, change) in changes {
        let mut written = motion(100);
        change(&mut written);
        let (_dir, paths) = files(&written);
        for path in paths {
            let e = read(&path).unwrap_err();
            let text = e.to_string();
            assert!(text.contains(expect), "{path:?}: {text}");
            assert!(text.starts_with(path.to_str().unwrap()) && !text.contains('\n'), "{text}");
            if expect != "no sample" {
                assert!(e.line == Some(52) || text.contains("message 51 of /measured"), "{text}");
            }
        }
    }
}

#[test]
fn progress_runs_from_0_to_1() {
    let (_dir, paths) = files(&motion(20_000));
    for path in paths {
        let mut reader = open(&path, &robot()).unwrap();
        let mut last = 0.0;
        while reader.next_sample().unwrap().is_some() {
            let now = reader.fraction();
            assert!(now >= last && now <= 1.0, "{path:?}: {now} after {last}");
            last = now;
        }
        assert!(last > 0.5, "{path:?}: {last}");
        assert_eq!(reader.fraction(), 1.0);
    }
}

#[test]
fn an_error_stays() {
    let mut written = motion(10);
    written[5].q_rad[0] = 1e12;
    let (_dir, paths) = files(&written);
    for path in paths {
        let mut reader = open(&path, &robot()).unwrap();
        let first = drain(&mut reader).unwrap_err();
        assert_eq!(reader.next_sample().unwrap_err(), first);
    }
}

#[test]
fn a_robot_that_does_not_fit_is_named_with_what_was_found() {
    let (_dir, paths) = files(&motion(10));
    let text = "kind = \"serial\"\nname = \"crane\"\njoints = [\"j1\", \"j2\", \"j3\"]\n[[dh]]\n[[dh]]\n[[dh]]\n";
    let crane = RobotFile::parse(text).unwrap();
    for path in paths {
        let e = open(&path, &crane).unwrap_err().to_string();
        assert!(e.contains("crane") && (e.contains("q3") || e.contains("shoulder, elbow")), "{e}");
    }
}

#[test]
fn a_file_cut_anywhere_reads_up_to_there() {
    let written = motion(2500);
    let (dir, paths) = files(&written);
    for path in paths {
        let bytes = std::fs::read(&path).unwrap();
        let cut = dir.path().join("cut").with_extension(path.extension().unwrap());
        let mut some = 0;
        for step in 1..=60 {
            let len = bytes.len() * step / 61 + step % 7;
            std::fs::write(&cut, &bytes[..len]).unwrap();
            let Ok((samples, ..)) = read(&cut) else {
                assert!(step < 10, "{cut:?}: nothing read from {len} of {} bytes", bytes.len());
                continue;
            };
            // A CSV number cut in its last digit still reads as a number: the last sample is not compared.
            let sure = samples.len().saturating_sub(1);
            assert!(samples[..sure].iter().zip(&written).all(|(a, b)| same(a, b)), "{cut:?} at {len}");
            some = some.max(samples.len());
        }
        assert!(some > 2000, "{path:?}: {some}");
    }
}

#[test]
fn files_of_no_known_format_are_refused_in_words() {
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes, expect) in [
        ("a.parquet", &b"PAR1...."[..], ".parquet"),
        ("a.bag", b"#ROSBAG V2.0\n", "ROS 1"),
        ("a.mcap", b"t,q1,tau1\n", "mcap signature"),
        ("noname", b"t,q1\n", "unknown format"),
    ] {
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let e = open(&path, &robot()).unwrap_err().to_string();
        assert!(e.contains(expect) && e.contains("expected"), "{e}");
    }
    let e = open(dir.path().join("absent.csv"), &robot()).unwrap_err().to_string();
    assert!(e.contains("no such file"), "{e}");
    let e = open(dir.path(), &robot()).unwrap_err().to_string();
    assert!(e.contains("folder with 1 .mcap") || e.contains("mcap signature"), "{e}");
}

/// A URDF names the joints one way, the robot's own controller another.
#[test]
fn joints_of_another_name_are_found() {
    let dir = tempfile::tempdir().unwrap();
    let own = robot();
    let text = "kind = \"serial\"\nname = \"arm\"\njoints = [\"j1\", \"j2\"]\n[[dh]]\na = 0.3\n[[dh]]\na = 0.2\n[columns]\n\
        temperature = [\"x_ta\", \"x_tb\"]\nlink_position = [\"x_enc\"]\nenabled = \"x_on\"\njoints = [\"shoulder\", \"elbow\"]\n";
    let other = RobotFile::parse(text).unwrap();
    let path = dir.path().join("a.mcap");
    write("mcap", &path, &motion(50));
    let [a, mut b] = [&own, &other].map(|robot| read_all(&path, robot).unwrap());
    assert_eq!(b.joints, ["j1", "j2"]);
    b.joints.clone_from(&a.joints);
    assert_eq!(format!("{a:?}"), format!("{b:?}"));
    let lost = RobotFile::parse(&text.replace("\"shoulder\", \"elbow\"", "\"shoulder\", \"hand\"")).unwrap();
    let e = read_all(&path, &lost).unwrap_err().to_string();
    assert!(e.contains("found joints shoulder, elbow; expected also hand"), "{e}");
    let path = dir.path().join("a.csv");
    std::fs::write(&path, "t,q_elbow,q_shoulder,tau_shoulder,tau_elbow\n0,1,2,3,4\n").unwrap();
    let table =
        RobotFile::parse(&text.replace("temperature", "#").replace("link_", "#").replace("enabled", "#")).unwrap();
    let read = read_all(&path, &table).unwrap();
    assert_eq!((read.q_rad[0][0], read.q_rad[1][0], read.tau_nm[1][0]), (2.0, 1.0, 4.0));
}

#[test]
fn a_survey_of_a_bag_names_the_joints() {
    use lacuna_recording::{Survey, survey};
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    write("mcap", &path, &motion(8000));
    let Some(Survey::Bag(topics)) = survey(&path).unwrap() else { panic!("no bag") };
    let found: Vec<_> = topics.iter().map(|t| (t.name.as_str(), t.position, t.effort)).collect();
    assert_eq!(found, [("/measured", true, true)]);
    assert_eq!(topics[0].joints, ["shoulder", "elbow"]);
    // A folder with it is a bag, too; half of the file still names them.
    assert_eq!(survey(dir.path()).unwrap(), Some(Survey::Bag(topics.clone())));
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() * 2 / 3]).unwrap();
    assert_eq!(survey(&path).unwrap(), Some(Survey::Bag(topics)));
}
