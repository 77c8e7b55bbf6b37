//! Fuzzing of everything that reads what others wrote: recordings, robot, model and graph files, URDF. Whatever the
//! bytes, the answer is a value or an error of one line, within a budget of memory.
//!
//! As a test this mutates valid files at random. `tests/fuzz.sh` builds the same targets with coverage instrumentation
//! and lets libFuzzer look for new paths for as long as it is told to.

mod common;

use allocation_counter::measure;
use bolero::check;
use common::{COMPRESSIONS, csv, motion, robot, write_mcap};
use lacuna_interfaces::graph::GraphFile;
use lacuna_interfaces::{BadInput, ModelFile, RobotFile};
use lacuna_recording::container::WriterOptions;
use lacuna_recording::messages::Messages;
use lacuna_recording::ros::definition::Decoded;
use lacuna_recording::{open, recover};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Which seed; edits as (place, kind, value); where to cut.
type Mutation = (u8, Vec<(u16, u8, u8)>, Option<u16>);

/// Words that parsers stumble over.
const WORDS: [&str; 20] = [
    "nan",
    "inf",
    "-1",
    "0",
    "1e308",
    "-1e-308",
    "99999999999999999999",
    "\"",
    "[[",
    "]]",
    "[",
    "]",
    "=",
    "\n",
    ",",
    "${",
    "}",
    "<",
    "/>",
    "\u{feff}",
];

/// Memory an input of a few kilobytes may take, whatever it claims: a chunk of a recording at its largest, twice.
const BUDGET: u64 = 160 << 20;
const ITERATIONS: usize = 1500;

fn mutate(seeds: &[Vec<u8>], (seed, edits, cut): &Mutation) -> Vec<u8> {
    let mut bytes = seeds[usize::from(*seed) % seeds.len()].clone();
    for (place, kind, value) in edits.iter().take(24) {
        let at = usize::from(*place) % (bytes.len() + 1);
        match kind % 6 {
            0 if at < bytes.len() => bytes[at] = *value,
            1 if at < bytes.len() => bytes[at] ^= 1 << (value % 8),
            2 => bytes.insert(at, *value),
            3 if at < bytes.len() => drop(bytes.drain(at..(at + usize::from(*value)).min(bytes.len()))),
            4 => {
                let end = (at + usize::from(*value)).min(bytes.len());
                let copy = bytes[at..end].to_vec();
                bytes.splice(at..at, copy);
            }
            _ => {
                let word = WORDS[usize::from(*value) % WORDS.len()].bytes();
                bytes.splice(at..at, word);
            }
        }
    }
    if let Some(cut) = cut {
        bytes.truncate(usize::from(*cut) % (bytes.len() + 1));
    }
    bytes
}

/// What became of the inputs of one target.
#[derive(Default)]
struct Judge {
    taken: AtomicUsize,
    refused: AtomicUsize,
}

impl Judge {
    /// Reads within the budget; an error is one line.
    fn judge<T>(&self, read: impl FnOnce() -> Result<T, BadInput>) {
        let mut line = None;
        let spent = measure(|| line = read().err().map(|e| e.to_string()));
        assert!(spent.bytes_max <= BUDGET, "{} bytes", spent.bytes_max);
        if let Some(line) = &line {
            assert!(!line.is_empty() && !line.contains('\n'), "{line:?}");
        }
        if line.is_some() { &self.refused } else { &self.taken }.fetch_add(1, Ordering::Relaxed);
    }

    /// Mutations that all pass, or all fail at the first byte, test nothing.
    fn saw_both(&self) {
        let [taken, refused] = [&self.taken, &self.refused].map(|n| n.load(Ordering::Relaxed));
        assert!(taken > ITERATIONS / 200 && refused > ITERATIONS / 10, "{taken} taken, {refused} refused");
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Reads a recording to its end or its error.
fn play(path: &Path, robot: &RobotFile) -> Result<(), BadInput> {
    let mut reader = open(path, robot)?;
    while let Some(sample) = reader.next_sample()? {
        assert!(sample.measured.q_rad.iter().all(|q| q.is_finite()), "a position that is no number");
    }
    Ok(())
}

/// Reads an MCAP's messages by the definitions in it, to its end or its error.
fn look(path: &Path) -> Result<(), BadInput> {
    let mut messages = Messages::open(path)?;
    let mut decoded = Decoded::default();
    while let Some(message) = messages.next_message()? {
        let Some(topic) = messages.topic(message.topic) else { continue };
        if topic.layout.is_some() {
            topic.decode(messages.data(), &mut decoded)?;
        }
    }
    Ok(())
}

/// Memory, not a disk: thousands of small files are written.
fn folder() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).expect("temporary folder")
}

#[test]
fn fuzz_csv() {
    let dir = folder();
    let path = dir.path().join("a.csv");
    let seeds = [csv(&motion(30)).into_bytes(), b"t,q1,q2,tau1,tau2\n0,1,2,3,4\n0.001,1,2,3,4\n".to_vec()];
    let seen = Judge::default();
    check!().with_iterations(ITERATIONS).with_type::<Mutation>().for_each(|m| {
        std::fs::write(&path, mutate(&seeds, m)).expect("file");
        seen.judge(|| play(&path, &robot()));
    });
    seen.saw_both();
}

#[test]
fn fuzz_mcap() {
    let dir = folder();
    let (path, to) = (dir.path().join("a.mcap"), dir.path().join("b.mcap"));
    let seeds = COMPRESSIONS.map(|compression| {
        let options = WriterOptions { compression, chunk_bytes: 1500, sync: None, ..WriterOptions::default() };
        write_mcap(&path, &motion(30), &options);
        let bytes = std::fs::read(&path).expect("file");
        std::fs::remove_file(&path).expect("file");
        bytes
    });
    let options = WriterOptions { overwrite: true, sync: None, ..WriterOptions::default() };
    let (seen, looked) = (Judge::default(), Judge::default());
    check!().with_iterations(ITERATIONS).with_type::<Mutation>().for_each(|m| {
        std::fs::write(&path, mutate(&seeds, m)).expect("file");
        seen.judge(|| play(&path, &robot()));
        looked.judge(|| look(&path));
        if let Err(e) = recover(&path, &to, &options) {
            assert!(!e.to_string().contains('\n'), "{e}");
        }
    });
    looked.saw_both();
    seen.saw_both();
}

const DELTA: &str = "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n[mass]\nplatform = 1.1\n\
upper_arm = 1.8\nforearm_point = 0.22\nrotor_inertia = 0.06\n[drive]\ngear_ratio = 33\nencoder_bits = 20\nsample_rate_hz = 1000\n";
const SERIAL: &str = "kind = \"serial\"\nname = \"s\"\njoints = [\"a\", \"b\"]\n[[dh]]\na = 0.4\n[[dh]]\na = 0.3\nalpha = 1.57\n[[link]]\nmass = 2.0\n\
com = [0.1, 0.0, 0.0]\ninertia = [0.1, 0.0, 0.0, 0.1, 0.0, 0.1]\n[[link]]\nmass = 1.0\ncom = [0.1, 0.0, 0.0]\n\
inertia = [0.1, 0.0, 0.0, 0.1, 0.0, 0.1]\n";

#[test]
fn fuzz_robot() {
    let seeds = [DELTA, SERIAL].map(|t| t.as_bytes().to_vec());
    let seen = Judge::default();
    check!().with_iterations(2 * ITERATIONS).with_type::<Mutation>().for_each(|m| {
        let text = text(&mutate(&seeds, m));
        // A robot file that passes must also make a robot, or be refused in words.
        seen.judge(|| RobotFile::parse(&text).and_then(|r| lacuna_physics::build(&r, None)));
    });
    seen.saw_both();
}

#[test]
fn fuzz_model() {
    let seeds = [b"schema = \"lacuna.model/1\"\nrobot = \"d\"\n[rigid_body]\nrho1 = 1.1\nrho2 = 1.05\n[friction]\nf_v = [0.5, 0.5, 0.5]\nf_c = [1.5, 1.5, 1.5]\n".to_vec()];
    let robot = RobotFile::parse(DELTA).expect("robot");
    let seen = Judge::default();
    check!().with_iterations(2 * ITERATIONS).with_type::<Mutation>().for_each(|m| {
        let text = text(&mutate(&seeds, m));
        seen.judge(|| {
            let model = ModelFile::parse(&text)?;
            model.check(&robot)?;
            model.to_toml().map(|_| ())
        });
    });
    seen.saw_both();
}

#[test]
fn fuzz_graph() {
    let seeds = ["replay", "live"].map(|name| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../launch/{name}.toml"));
        std::fs::read(path).expect("launch file")
    });
    let seen = Judge::default();
    check!().with_iterations(2 * ITERATIONS).with_type::<Mutation>().for_each(|m| {
        let text = text(&mutate(&seeds, m));
        seen.judge(|| GraphFile::parse(&text).and_then(|g| g.resolve(&[("out".to_owned(), "x.mcap".to_owned())])));
    });
    seen.saw_both();
}

#[test]
fn fuzz_urdf() {
    let seeds = [br#"<robot name="r"><link name="base"/>
<joint name="a" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 0 0.5" rpy="0 1 0"/><axis xyz="0 0 1"/></joint>
<link name="one"><inertial><origin xyz="0.1 0 0"/><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="b" type="prismatic"><parent link="one"/><child link="two"/><axis xyz="0 1 0"/></joint>
<link name="two"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>"#
        .to_vec()];
    let file = "kind = \"serial\"\nname = \"r\"\nurdf = \"r.urdf\"\njoints = [\"a\", \"b\"]\n";
    let robot = RobotFile::parse(file).expect("robot");
    let seen = Judge::default();
    check!().with_iterations(2 * ITERATIONS).with_type::<Mutation>().for_each(|m| {
        let text = text(&mutate(&seeds, m));
        seen.judge(|| lacuna_physics::build(&robot, Some(&text)));
    });
    seen.saw_both();
}

const DRIVES: &str = "kind = \"serial\"\nname = \"pair\"\njoints = [\"shoulder\", \"elbow\"]\n[[dh]]\n[[dh]]\n[drive]\n\
gear_ratio = [100, -50]\nencoder_bits = [20, 19]\nrated_torque_nm = [200, 80]\n";

fn data(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)).expect("test data")
}

#[test]
fn fuzz_capture() {
    let by_address = "[ethercat]\ncycle_s = 0.001\n[[ethercat.axis]]\nposition = 0x01000000\ntorque = 0x01000004\n\
        status = 0x01000006\n[[ethercat.axis]]\nposition = 0x01000008\ntorque = 0x0100000c\n";
    let robot = RobotFile::parse(&format!("{DRIVES}{by_address}")).expect("robot");
    let dir = folder();
    let path = dir.path().join("a.pcap");
    let seeds = ["drives_us.pcap", "drives_ns_be.pcap", "drives.pcapng"].map(data);
    let seen = Judge::default();
    check!().with_iterations(ITERATIONS).with_type::<Mutation>().for_each(|m| {
        std::fs::write(&path, mutate(&seeds, m)).expect("file");
        seen.judge(|| play(&path, &robot));
    });
    seen.saw_both();
}

#[test]
fn fuzz_eni() {
    let by_name = "[ethercat]\neni = \"drives.xml\"\n[[ethercat.axis]]\nslave = \"Drive 1\"\n[[ethercat.axis]]\nslave = \"Drive 2\"\n";
    let dir = folder();
    let path = dir.path().join("robot.toml");
    std::fs::write(&path, format!("{DRIVES}{by_name}")).expect("file");
    let seeds = [data("drives.xml")];
    let seen = Judge::default();
    check!().with_iterations(ITERATIONS).with_type::<Mutation>().for_each(|m| {
        std::fs::write(dir.path().join("drives.xml"), mutate(&seeds, m)).expect("file");
        seen.judge(|| lacuna_recording::load_robot(&path));
    });
    seen.saw_both();
}
