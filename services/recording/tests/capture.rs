//! EtherCAT captures against what the generator (`tests/oracles/ethercat_captures.py`, scapy) put into them.

use lacuna_interfaces::{JointMeasured, Repair, RepairKind, RobotFile, flag};
use lacuna_recording::{load_robot, open, read_all};
use proptest::prelude::*;
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};
use std::process::Command;

const HEAD: &str = "kind = \"serial\"\nname = \"pair\"\njoints = [\"shoulder\", \"elbow\"]\n[[dh]]\n[[dh]]\n\
    [drive]\ngear_ratio = [100, -50]\nencoder_bits = [20, 19]\nrated_torque_nm = [200, 80]\n";
const BY_ADDRESS: &str = "[ethercat]\ncycle_s = 0.001\n[[ethercat.axis]]\nposition = 0x01000000\ntorque = 0x01000004\n\
    status = 0x01000006\noffset_rad = 0.25\n[[ethercat.axis]]\nposition = 0x01000008\ntorque = 0x0100000c\n\
    status = { station = 1002, offset = 0x1100 }\n";
const BY_NAME: &str = "[ethercat]\neni = \"drives.xml\"\n[[ethercat.axis]]\nslave = \"Drive 1\"\noffset_rad = 0.25\n\
    [[ethercat.axis]]\nposition = \"Drive 2.Position actual value\"\nslave = \"Drive 2\"\n\
    status = \"Drive 2.Status word\"\n";

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn robot() -> RobotFile {
    RobotFile::parse(&format!("{HEAD}{BY_ADDRESS}")).unwrap()
}

/// A robot file beside the ENI file.
fn beside_eni(table: &str) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    std::fs::copy(data("drives.xml"), dir.path().join("drives.xml")).unwrap();
    let path = dir.path().join("robot.toml");
    std::fs::write(&path, format!("{HEAD}{table}")).unwrap();
    (dir, path)
}

fn drain(path: &Path, robot: &RobotFile) -> (Vec<JointMeasured>, Vec<Repair>) {
    let mut reader = open(path, robot).unwrap();
    let mut all = Vec::new();
    while let Some(sample) = reader.next_sample().unwrap() {
        all.push(sample.measured);
    }
    (all, reader.repairs())
}

/// What the generator wrote: stamp, then six counts.
fn truth() -> Vec<(i64, [i64; 6])> {
    let text = std::fs::read_to_string(data("drives.csv")).unwrap();
    let row = |line: &str| {
        let mut cells = line.split(',').map(|c| c.parse::<i64>().unwrap());
        (cells.next().unwrap(), std::array::from_fn(|_| cells.next().unwrap()))
    };
    text.lines().skip(1).map(row).collect()
}

/// In words, since NaN stands for "no such signal" and is not equal to itself.
fn shown(what: &impl std::fmt::Debug) -> String {
    format!("{what:?}")
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-12 * b.abs().max(1.0)
}

#[test]
fn every_cycle_comes_back_in_joint_units() {
    for name in ["drives_us.pcap", "drives_ns_be.pcap", "drives.pcapng"] {
        let (samples, repairs) = drain(&data(name), &robot());
        let truth = truth();
        assert_eq!(samples.len(), truth.len(), "{name}");
        for (m, (stamp, [p1, t1, s1, p2, t2, _])) in samples.iter().zip(truth) {
            assert_eq!(m.header.stamp_ns, stamp, "{name}");
            // The counter of drive 1 passes 2^31 and goes on from −2^31.
            let p1 = if p1 < 0 { p1 + (1_i64 << 32) } else { p1 } as f64;
            assert!(close(m.q_rad[0], p1 * TAU / (f64::from(1 << 20) * 100.0) + 0.25), "{name} {}", m.q_rad[0]);
            assert!(close(m.q_rad[1], p2 as f64 * TAU / (f64::from(1 << 19) * -50.0)), "{name} {}", m.q_rad[1]);
            assert!(close(m.tau_nm[0], t1 as f64 * 0.2), "{name} {}", m.tau_nm[0]);
            assert!(close(m.tau_nm[1], -t2 as f64 * 0.08), "{name} {}", m.tau_nm[1]);
            assert_eq!(m.header.has(flag::DRIVE_OFF), s1 == 0x1233, "{name}");
            let after_hole = [21, 31].contains(&((stamp - 1_700_000_000_123_493_000) / 1_000_000));
            assert_eq!(m.header.has(flag::GAP), after_hole, "{name} {stamp}");
        }
        let count = |kind| repairs.iter().filter(|r| r.kind == kind).map(|r| r.count).sum::<u64>();
        assert_eq!(count(RepairKind::WorkingCounter), 1, "{name}: {repairs:?}");
        assert_eq!(count(RepairKind::MissingCycle), 2, "{name}: {repairs:?}");
    }
}

/// Whoever does not say how long a cycle is still hears of a drive that did not answer.
#[test]
fn a_cycle_left_out_is_flagged_without_its_length() {
    let robot = RobotFile::parse(&format!("{HEAD}{}", BY_ADDRESS.replace("cycle_s = 0.001\n", ""))).unwrap();
    let (samples, repairs) = drain(&data("drives_us.pcap"), &robot);
    let cycle = |m: &JointMeasured| (m.header.stamp_ns - 1_700_000_000_123_493_000) / 1_000_000;
    let flagged: Vec<i64> = samples.iter().filter(|m| m.header.has(flag::GAP)).map(cycle).collect();
    assert_eq!(flagged, [21]);
    assert_eq!(repairs.iter().map(|r| (r.kind, r.count)).collect::<Vec<_>>(), [(RepairKind::WorkingCounter, 1)]);
}

#[test]
fn names_of_the_eni_file_are_the_same_places() {
    let (_dir, path) = beside_eni(BY_NAME);
    let by_name = load_robot(&path).unwrap().file;
    let [a, b] = [&by_name, &robot()].map(|robot| shown(&drain(&data("drives.pcapng"), robot)));
    assert!(a == b, "{a}\n{b}");
    // Without tables the drives are the joints; their status words are then read where the slave has them.
    let (_dir, path) = beside_eni("[ethercat]\neni = \"drives.xml\"\n");
    let found = load_robot(&path).unwrap().file;
    let whole = read_all(data("drives_us.pcap"), &found).unwrap();
    assert_eq!(whole.len(), truth().len());
    assert!(whole.extra.is_empty(), "only one drive gives a status word there");
    let whole = read_all(data("drives_us.pcap"), &robot()).unwrap();
    assert_eq!(whole.extra["x_status1"].iter().filter(|s| **s == f64::from(0x1233)).count(), 10);
}

#[test]
fn what_the_robot_file_lacks_is_said() {
    for (from, to, expect) in [
        ("encoder_bits = [20, 19]\n", "", "joint shoulder: found no drive.encoder_bits"),
        ("rated_torque_nm = [200, 80]\n", "", "joint shoulder: found no drive.rated_torque_nm"),
        ("name = \"pair\"\n", "name = \"pair\"\ntorque_unit = \"A\"\n", "per mille"),
        (BY_ADDRESS, "", "no [ethercat] in the robot file"),
    ] {
        let text = format!("{HEAD}{BY_ADDRESS}").replace(from, to);
        let e = open(data("drives_us.pcap"), &RobotFile::parse(&text).unwrap()).unwrap_err().to_string();
        assert!(e.contains(expect) && e.contains("drives_us.pcap: ") && !e.contains('\n'), "{e}");
    }
    for (from, to, expect) in [
        ("Drive 1", "Drive 7", "expected also \"Drive 7\""),
        ("\"Drive 2.Status word\"", "\"Drive 2.Status\"", "no input variable \"Drive 2.Status\""),
        ("\"Drive 2.Status word\"", "\"Drive 2.Position actual value\"", "found 32 bits; expected 16"),
        ("\"Drive 2.Status word\"", "\"Odd\"", "bit 243; expected a whole byte"),
        ("\"Drive 2.Status word\"", "\"Nowhere\"", "no cyclic command"),
        ("\"Drive 1\"", "\"Coupler\"", "found only nothing"),
        ("drives.xml", "other.xml", "other.xml: found no such file"),
    ] {
        let (_dir, path) = beside_eni(&BY_NAME.replacen(from, to, 1));
        let e = load_robot(&path).unwrap_err().to_string();
        assert!(e.contains(expect) && e.contains(".xml: ") && !e.contains('\n'), "{to}: {e}");
    }
    let (_dir, path) = beside_eni("[ethercat]\neni = \"robot.toml\"\n");
    assert!(load_robot(&path).unwrap_err().to_string().contains("robot.toml:1: found no well-formed XML"));
}

#[test]
fn a_capture_cut_anywhere_reads_up_to_there() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["drives_us.pcap", "drives.pcapng"] {
        let bytes = std::fs::read(data(name)).unwrap();
        let (whole, _) = drain(&data(name), &robot());
        let path = dir.path().join(name);
        for len in (40..bytes.len()).step_by(211) {
            std::fs::write(&path, &bytes[..len]).unwrap();
            let Ok(mut reader) = open(&path, &robot()) else { continue };
            let mut count = 0;
            while let Ok(Some(sample)) = reader.next_sample() {
                assert_eq!(shown(&sample.measured), shown(&whole[count]), "{name} cut at {len}");
                count += 1;
            }
            assert!(count + 2 >= whole.len() * len.saturating_sub(400) / bytes.len(), "{name} at {len}: {count}");
        }
    }
}

#[test]
fn other_traffic_and_short_captures_are_refused_in_words() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = std::fs::read(data("drives_us.pcap")).unwrap();
    let path = dir.path().join("a.pcap");
    let refused = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        match open(&path, &robot()) {
            Ok(mut reader) => loop {
                match reader.next_sample() {
                    Ok(Some(_)) => {}
                    Ok(None) => panic!("accepted"),
                    Err(e) => break e.to_string(),
                }
            },
            Err(e) => e.to_string(),
        }
    };
    // The first frame alone is no EtherCAT.
    let e = refused(&bytes[..24 + 16 + 60]);
    assert!(e.contains("found 1 frames, none of EtherCAT"), "{e}");
    // A capture length of 40 bytes.
    let mut short = bytes[..24 + 16 + 60].to_vec();
    let packet = &bytes[24 + 16 + 60..24 + 2 * (16 + 60)];
    short.extend(&packet[..8]);
    short.extend(40_u32.to_le_bytes());
    short.extend(&packet[12..16 + 40]);
    let e = refused(&short);
    assert!(e.contains("frame 2: ") && e.contains("whole frames"), "{e}");
    let mut wifi = bytes.clone();
    wifi[20] = 105;
    assert!(refused(&wifi).contains("link type 105; expected 1, Ethernet"));
}

#[test]
fn a_survey_lists_the_process_data() {
    use lacuna_recording::{Survey, survey};
    let Some(Survey::Bus(bus)) = survey(&data("drives.pcapng")).unwrap() else { panic!("not a bus") };
    assert_eq!((bus.frames, bus.ethercat), (1 + 2 * 59, 2 * 59));
    let (first, last) = bus.stamps_ns.unwrap();
    assert_eq!(last - first, 59_000_000 + 5_000_000 + 37_000);
    let seen: Vec<_> =
        bus.datagrams.iter().map(|d| (d.command.name(), d.address, d.bytes, d.working_counter)).collect();
    assert_eq!(seen, [("FPRD", 1002 | 0x1100 << 16, 2, 1), ("LRW", 0x0100_0000, 14, 6)]);
    // 59 cycles were captured; in one of them drive 2 did not answer.
    assert_eq!(bus.datagrams.iter().map(|d| (d.copies, d.returned)).collect::<Vec<_>>(), [(118, 59), (118, 58)]);
}

/// tshark's own dissector must see the same stamps and counts, whatever the capture's clock.
#[test]
fn tshark_reads_the_same() {
    let fields = ["frame.time_epoch", "ecat.cnt", "ecat.data"];
    for name in ["drives_us.pcap", "drives_ns_be.pcap", "drives.pcapng"] {
        let mut tshark = Command::new("tshark");
        tshark.args(["-r", data(name).to_str().unwrap(), "-Y", "ecat", "-T", "fields"]);
        let Ok(output) = tshark.args(fields.iter().flat_map(|f| ["-e", f])).output() else {
            eprintln!("SKIPPED: tshark is not installed");
            return;
        };
        let text = String::from_utf8(output.stdout).unwrap();
        let mut rows = text.lines().map(|line| line.split('\t').collect::<Vec<_>>());
        for (stamp, [p1, t1, s1, p2, t2, s2]) in truth() {
            // The copy that all slaves have handled, in a cycle in which they all did.
            let cells = rows.find(|cells| cells[1] == "6,1").unwrap_or_else(|| panic!("{name}: no row for {stamp}"));
            let (seconds, part) = cells[0].split_once('.').unwrap();
            assert_eq!(format!("{seconds}{part:0<9}"), stamp.to_string(), "{name}");
            let data: Vec<String> = cells[2].split(',').map(|d| d.replace(':', "")).collect();
            let byte = |d: usize, i: usize| u8::from_str_radix(&data[d][2 * i..2 * i + 2], 16).unwrap();
            assert_eq!(i64::from(i32::from_le_bytes(std::array::from_fn(|i| byte(0, i)))), p1, "{cells:?}");
            assert_eq!(i64::from(i16::from_le_bytes([byte(0, 4), byte(0, 5)])), t1);
            assert_eq!(i64::from(u16::from_le_bytes([byte(0, 6), byte(0, 7)])), s1);
            assert_eq!(i64::from(i32::from_le_bytes(std::array::from_fn(|i| byte(0, 8 + i)))), p2);
            assert_eq!(i64::from(i16::from_le_bytes([byte(0, 12), byte(0, 13)])), t2);
            assert_eq!(i64::from(u16::from_le_bytes([byte(1, 0), byte(1, 1)])), s2);
        }
        assert!(rows.all(|cells| cells[1] != "6,1"), "{name}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    /// Damaged bytes anywhere: an error or fewer samples, never a panic.
    #[test]
    fn damage_is_survived(which in 0usize..3, hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12)) {
        let name = ["drives_us.pcap", "drives_ns_be.pcap", "drives.pcapng"][which];
        let mut bytes = std::fs::read(data(name)).unwrap();
        for (at, value) in hits {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        if let Ok(mut reader) = open(&path, &robot()) {
            let mut count = 0;
            while let Ok(Some(_)) = reader.next_sample() {
                count += 1;
                prop_assert!(count < 200);
            }
        }
    }
}
