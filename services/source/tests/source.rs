//! What the source promises: one unbroken sequence, stamps that increase, pacing that follows them.

use lacuna_interfaces::{BadInput, JointMeasured, RepairKind, RobotFile, flag};
use lacuna_source::{Config, Source};
use std::fmt::Write as _;
use std::path::Path;

fn robot() -> RobotFile {
    RobotFile::parse("kind = \"serial\"\nname = \"r\"\njoints = [\"servo\"]\n[[dh]]\n").unwrap()
}

/// `n` samples at 1 kHz from `start_s` on; q is the sample's number.
fn csv(folder: &Path, name: &str, start_s: f64, n: usize) -> String {
    let mut text = "t,q1,tau1\n".to_owned();
    for k in 0..n {
        writeln!(text, "{:.6},{k},0.5", start_s + k as f64 * 1e-3).unwrap();
    }
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

fn source(config: &str) -> Result<Source, BadInput> {
    let config: Config = toml::from_str(config).map_err(|e| BadInput::from_toml(&e, config))?;
    Source::new(config, &robot())
}

fn drain(source: &mut Source) -> Vec<JointMeasured> {
    let mut all = Vec::new();
    let mut m = JointMeasured::default();
    while source.next_sample(&mut m).unwrap() {
        all.push(m);
    }
    assert!(!source.next_sample(&mut m).unwrap(), "the end stays the end");
    all
}

#[test]
fn several_recordings_become_one_stream() {
    let dir = tempfile::tempdir().unwrap();
    let files = [
        csv(dir.path(), "a.csv", 0.001, 100),
        csv(dir.path(), "b.csv", 0.001, 50),
        // This one lies later on the same clock: its stamps are kept.
        csv(dir.path(), "c.csv", 100.0, 50),
    ];
    let mut source = source(&format!("recording = {files:?}\nbetween_s = 0.5")).unwrap();
    let all = drain(&mut source);
    assert_eq!((all.len(), source.count()), (200, 200));
    assert!(all.iter().zip(1..).all(|(m, seq)| m.header.seq == seq && m.header.joints == 1));
    assert!(all.windows(2).all(|w| w[0].header.stamp_ns < w[1].header.stamp_ns));
    assert_eq!(all[100].header.stamp_ns - all[99].header.stamp_ns, 500_000_000);
    assert_eq!(all[150].header.stamp_ns, 100_000_000_000);
    let gaps: Vec<_> = (0..200).filter(|&k| all[k].header.has(flag::GAP)).collect();
    assert_eq!(gaps, [100, 150]);
    assert_eq!(all[107].q_rad[0], 7.0);
    assert_eq!(source.fraction(), 1.0);
}

#[test]
fn windows_and_limits_cut_the_stream() {
    let dir = tempfile::tempdir().unwrap();
    let file = csv(dir.path(), "a.csv", 50.0, 1000);
    let q = |more: &str| {
        let all = drain(&mut source(&format!("recording = '{file}'\n{more}")).unwrap());
        assert_eq!(all[0].header.seq, 1);
        (all.len(), all[0].q_rad[0], all[all.len() - 1].q_rad[0])
    };
    assert_eq!(q(""), (1000, 0.0, 999.0));
    assert_eq!(q("from_s = 0.2"), (800, 200.0, 999.0));
    assert_eq!(q("from_s = 0.2\nto_s = 0.3"), (100, 200.0, 299.0));
    assert_eq!(q("limit = 7"), (7, 0.0, 6.0));
    assert_eq!(q("from_s = 0.2\nlimit = 7"), (7, 200.0, 206.0));
}

#[test]
fn pacing_follows_the_stamps() {
    let dir = tempfile::tempdir().unwrap();
    let file = csv(dir.path(), "a.csv", 50.0, 100);
    let due = |rate: &str| {
        let mut source = source(&format!("recording = '{file}'\nrate = {rate}")).unwrap();
        let all = drain(&mut source);
        all.iter().map(|m| source.due_ns(m.header.stamp_ns)).collect::<Vec<_>>()
    };
    assert!(due("\"max\"").iter().all(Option::is_none));
    assert_eq!(due("1.0")[..3], [Some(0), Some(1_000_000), Some(2_000_000)]);
    assert_eq!(due("4")[99], Some(99_000_000 / 4));
    assert_eq!(due("\"0.5\"")[1], Some(2_000_000), "as --set hands it over");
}

#[test]
fn configurations_without_sense_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let file = csv(dir.path(), "a.csv", 0.0, 10);
    for (more, expect) in [
        ("rate = 0", "positive factor"),
        ("rate = 'fast'", "positive factor"),
        ("rate = nan", "positive factor"),
        ("from_s = -1.0", "from_s"),
        ("from_s = 2.0\nto_s = 1.0", "to_s"),
        ("to_s = nan", "to_s"),
        ("between_s = 0.0", "between_s"),
        ("joints = ['elbow']", "found elbow; expected servo"),
        ("colour = 1", "colour"),
        ("time = 'gps'", "gps"),
    ] {
        let e = source(&format!("recording = '{file}'\n{more}")).unwrap_err().to_string();
        assert!(e.contains(expect), "{e}");
    }
    for (config, expect) in [
        ("recording = ''", "found no path"),
        ("recording = []", "found no path"),
        ("recording = 'absent.csv'", "no such file"),
        ("recording = 7", "path or a list of paths"),
        ("", "recording"),
    ] {
        let e = source(config).unwrap_err().to_string();
        assert!(e.contains(expect), "{e}");
    }
    let e = source(&format!("recording = ['{file}', '{file}x']")).unwrap_err().to_string();
    assert!(e.contains("a.csvx"), "a missing second file is found at the start: {e}");
}

#[test]
fn repairs_of_all_recordings_are_reported() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    for name in ["a.csv", "b.csv"] {
        std::fs::write(path(name), "t,q1,tau1\n0,0,0\n0,1,0\n0.1,2,0\n0.2,3").unwrap();
    }
    let mut source = source(&format!("recording = {:?}", [path("a.csv"), path("b.csv")])).unwrap();
    assert_eq!(drain(&mut source).len(), 4);
    let repairs: Vec<_> = source.repairs().into_iter().map(|r| (r.file, r.kind, r.count)).collect();
    let of = |file: &str, kind| (file.to_owned(), kind, 1);
    assert_eq!(
        repairs,
        [
            of("a.csv", RepairKind::DuplicateStamp),
            of("a.csv", RepairKind::TruncatedTail),
            of("b.csv", RepairKind::DuplicateStamp),
            of("b.csv", RepairKind::TruncatedTail)
        ]
    );
}

#[test]
fn an_error_in_mid_stream_names_its_line() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.csv");
    std::fs::write(&path, "t,q1,tau1\n0,0,0\n0.1,x,0\n").unwrap();
    let mut source = source(&format!("recording = '{}'", path.display())).unwrap();
    let mut m = JointMeasured::default();
    assert!(source.next_sample(&mut m).unwrap());
    assert_eq!(source.next_sample(&mut m).unwrap_err().line, Some(3));
}
