//! The live view: an independent viewer gets what is recorded, thinned out; a replay cannot have one; the layouts name
//! what is there.

use lacuna_recording::ros::cdr::Cursor;
use lacuna_tests::{Bench, error_line, messages, python, report, workspace};
use std::collections::{BTreeMap, BTreeSet};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Stdio};

const CLIENT: &str = "tests/oracles/view_client.py";
const SLOT_NS: u64 = 20_000_000;

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr()).expect("a free port").port()
}

fn args<'a>(graph: &'a str, sets: &[&'a str]) -> Vec<&'a str> {
    let files = ["recording=run.csv", "robot=robot.toml", "model=model.toml", "out=run.mcap"];
    [graph].into_iter().chain(files.iter().chain(sets).flat_map(|set| ["--set", set])).collect()
}

#[test]
fn a_viewer_gets_what_is_recorded_thinned_out() {
    let Some(python) = python("a_viewer_gets_what_is_recorded_thinned_out", &[CLIENT, "probe"]) else { return };
    let bench = Bench::with_motion(4.0);
    let port = free_port();
    let client = |how: &str, a: &str, b: &str| {
        let mut command = Command::new(&python);
        command.arg(workspace().join(CLIENT)).args([how, a, b]).current_dir(bench.path());
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command.spawn().expect("Python starts")
    };
    let watching = client("watch", &port.to_string(), "came.bin");
    let graph = workspace().join("launch/view.toml").display().to_string();
    let listen = format!("view_port={port}");
    let args = args(&graph, &[&listen]);
    let run = bench.up(args[0], &args[1..]);
    let report = report(&run.output());
    let watched = watching.wait_with_output().expect("the viewer ends");
    assert!(watched.status.success(), "{}", String::from_utf8_lossy(&watched.stderr));

    let said: serde_json::Value = serde_json::from_slice(&watched.stdout).expect("JSON");
    assert_eq!(said["server"], "lacuna view");
    // Nobody can write to the robot's graph through it.
    assert_eq!(said["capabilities"], serde_json::json!([]));
    let recorded = messages(&bench.path().join("run.mcap"));
    let topics = said["topics"].as_object().expect("topics");
    assert_eq!(topics["/measured"], serde_json::json!(["sensor_msgs/msg/JointState", "ros2msg", "cdr"]));
    for topic in recorded.keys() {
        assert!(topics.contains_key(topic), "{topic} is recorded and not shown");
    }
    let compared = client("compare", "came.bin", "run.mcap").wait_with_output().expect("the comparison ends");
    assert!(compared.status.success(), "{}", String::from_utf8_lossy(&compared.stderr));
    let compared: serde_json::Value = serde_json::from_slice(&compared.stdout).expect("JSON");
    let compared = compared.as_object().expect("topics");
    // The simulated drive has no details to measure; all the rest came.
    assert_eq!(compared.keys().collect::<Vec<_>>(), recorded.keys().collect::<Vec<_>>());
    for (topic, found) in compared {
        let came = found["came"].as_u64().expect("count");
        assert!(came >= 20, "{topic}: only {came} messages of four seconds at 50 Hz");
        assert_eq!(found["equal"].as_u64(), Some(came), "{topic}: {}", found["difference"]);
        let stamps: Vec<u64> = found["stamps"].as_array().expect("stamps").iter().filter_map(|s| s.as_u64()).collect();
        // The monitor (and the status that goes with it) also tells of an alarm that changes within a slot.
        let alone = stamps.windows(2).all(|w| w[0] / SLOT_NS < w[1] / SLOT_NS);
        assert!(alone || ["/monitor", "/status"].contains(&topic.as_str()), "{topic}: more than one in a slot");
    }
    let details = &report["nodes"]["view"]["details"];
    for (topic, received) in report["nodes"]["view"]["received"].as_object().expect("counts") {
        let (shown, passed) = (details["shown"][topic].as_u64(), details["passed_over"][topic].as_u64());
        assert_eq!(shown.zip(passed).map(|(a, b)| a + b), received.as_u64(), "{topic}");
    }
}

#[test]
fn a_replay_has_no_live_view_and_a_taken_port_is_said() {
    let bench = Bench::with_motion(0.5);
    let text = std::fs::read_to_string(workspace().join("launch/view.toml")).expect("graph");
    let replay = text.replace("mode = \"live\"", "mode = \"replay\"").replace("restart = \"on-failure\"\n", "");
    bench.write("replay.toml", &replay.replace("rate = 1.0 ", "rate = \"max\" "));
    let mut up = vec!["up", "--quiet"];
    up.extend(args("replay.toml", &[]));
    let out = bench.lacuna(&up);
    let line = error_line(&out);
    assert_eq!(out.status.code(), Some(2), "{line}");
    assert!(line.contains("live view") && line.contains("replay"), "{line}");
    assert!(!bench.path().join("run.mcap").exists());

    let taken = TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = format!("view_port={}", taken.local_addr().expect("address").port());
    let graph = workspace().join("launch/view.toml").display().to_string();
    let mut up = vec!["up", "--quiet"];
    up.extend(args(&graph, &[&port]));
    let out = bench.lacuna(&up);
    let line = error_line(&out);
    assert_eq!(out.status.code(), Some(2), "{line}");
    assert!(line.contains("cannot listen") && line.contains(&port["view_port=".len()..]), "{line}");
}

/// What a recording of the graph has: (topic, field) with the number of values in it, 0 for a single one.
struct Signals {
    fields: BTreeMap<(String, String), usize>,
    joints: Vec<String>,
}

impl Signals {
    fn of(path: &Path) -> Self {
        let bytes = std::fs::read(path).expect("recording");
        let mut found = Self { fields: BTreeMap::new(), joints: Vec::new() };
        for message in mcap::MessageStream::new(&bytes).expect("an MCAP file") {
            let message = message.expect("a message");
            let topic = message.channel.topic.clone();
            let schema = message.channel.schema.as_ref().expect("a schema");
            if schema.name == "sensor_msgs/msg/JointState" {
                let mut cursor = Cursor::new(&message.data).expect("CDR");
                cursor.header().expect("header");
                let names = cursor.strings().expect("names");
                found.joints = cursor.strings_of(names);
                for field in ["position", "velocity", "effort"] {
                    // A list that this topic leaves empty is not there for a viewer.
                    let count = cursor.numbers().expect("a list").len();
                    if count > 0 {
                        found.fields.insert((topic.clone(), field.to_owned()), count);
                    }
                }
                continue;
            }
            let text = String::from_utf8_lossy(&schema.data).into_owned();
            let own = text.split("====").next().unwrap_or_default();
            let fields = own.lines().map(|l| l.split('#').next().unwrap_or_default());
            for words in fields.map(|l| l.split_whitespace().collect::<Vec<_>>()) {
                // Lists of our own messages hold one value per joint.
                if let [kind, name] = words[..]
                    && !name.contains('=')
                {
                    let count = if kind.ends_with("[]") { found.joints.len() } else { 0 };
                    found.fields.insert((topic.clone(), name.to_owned()), count);
                }
            }
        }
        found
    }

    fn check(&self, layout: &str, topic: &str, field: &str, index: Option<usize>) {
        let there = self.fields.get(&(topic.to_owned(), field.to_owned()));
        let fits = there.is_some_and(|&count| index.map_or(count == 0, |i| i < count));
        assert!(fits, "{layout}: {topic} {field} {index:?} is not in a recording");
    }
}

/// `score[2]` → (`score`, 2).
fn indexed(field: &str) -> (&str, Option<usize>) {
    match field.strip_suffix(']').and_then(|f| f.split_once('[')) {
        Some((name, index)) => (name, Some(index.parse().expect("an index"))),
        None => (field, None),
    }
}

#[test]
fn layouts_name_what_a_recording_holds() {
    let bench = Bench::with_motion(1.0);
    let graph = workspace().join("launch/replay.toml").display().to_string();
    let mut up = vec!["up", "--json"];
    up.extend(args(&graph, &[]));
    report(&bench.lacuna(&up));
    let signals = Signals::of(&bench.path().join("run.mcap"));
    let layouts = workspace().join("launch/layouts");

    let text = std::fs::read_to_string(layouts.join("foxglove.json")).expect("layout");
    let layout: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let mut count = 0;
    for plot in layout["configById"].as_object().expect("panels").values() {
        for path in plot["paths"].as_array().into_iter().flatten() {
            let (topic, field) = path["value"].as_str().and_then(|v| v.split_once('.')).expect("topic.field");
            let (field, index) = indexed(field);
            signals.check("foxglove.json", topic, field, index);
            count += 1;
        }
    }
    assert!(count > 20, "{count} signals");

    let text = std::fs::read_to_string(layouts.join("plotjuggler.xml")).expect("layout");
    let curves: Vec<&str> =
        text.split("<curve name=\"").skip(1).map(|rest| rest.split('"').next().unwrap_or_default()).collect();
    assert_eq!(curves.len(), count, "both layouts show the same signals");
    for curve in curves {
        let (start, field) = curve.rsplit_once('/').expect("topic/field");
        let (field, index) = indexed(field);
        if ["position", "velocity", "effort"].contains(&field) {
            let (topic, joint) = start.rsplit_once('/').expect("topic/joint");
            let at = signals.joints.iter().position(|j| j == joint);
            assert!(at.is_some(), "plotjuggler.xml: {curve}: the robot has {:?}", signals.joints);
            signals.check("plotjuggler.xml", topic, field, at);
        } else {
            signals.check("plotjuggler.xml", start, field, index);
        }
    }
}

#[test]
fn layouts_are_made_for_any_joints_and_rerun_finds_its_entities() {
    let name = "layouts_are_made_for_any_joints_and_rerun_finds_its_entities";
    let Some(python) = python(name, &["--version"]) else { return };
    let layouts = workspace().join("launch/layouts");
    let bench = Bench::new();
    let make = |out: &str, more: &[&str]| {
        let done = Command::new(&python)
            .arg(layouts.join("make.py"))
            .args(["--out", out])
            .args(more)
            .current_dir(bench.path())
            .output()
            .expect("Python starts");
        (
            done.status.code(),
            ["foxglove.json", "plotjuggler.xml"].map(|f| std::fs::read_to_string(bench.path().join(out).join(f)).ok()),
        )
    };
    let (_, same) = make("same", &[]);
    let committed = ["foxglove.json", "plotjuggler.xml"].map(|f| std::fs::read_to_string(layouts.join(f)).ok());
    assert_eq!(same, committed, "launch/layouts is not what make.py makes");
    let (_, other) = make("other", &["--joints", "shoulder,elbow"]);
    assert!(other.iter().flatten().all(|text| text.contains("elbow") && !text.contains("q1")));
    assert_eq!(make("bad", &["--joints", "a,a"]).0, Some(2));

    let list = Command::new(&python).arg(layouts.join("rerun_blueprint.py")).arg("--list").output().expect("Python");
    let entities = String::from_utf8_lossy(&list.stdout).into_owned();
    // Rerun puts the lists of a JointState below its topic.
    let shown: BTreeSet<&str> = entities.lines().collect();
    assert!(shown.len() > 5);
    let graph = workspace().join("launch/replay.toml").display().to_string();
    let motion = Bench::with_motion(0.5);
    let mut up = vec!["up", "--json"];
    up.extend(args(&graph, &[]));
    report(&motion.lacuna(&up));
    let signals = Signals::of(&motion.path().join("run.mcap"));
    for entity in shown {
        let (topic, field) = entity.rsplit_once('/').expect("topic/field");
        signals.check("rerun_blueprint.py", topic, field, Some(0));
    }
}
