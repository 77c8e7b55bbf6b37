//! The monitor at work in the graph: quiet on a clean recording, an alarm in the recording when a load is carried that
//! the model does not know.

use lacuna_recording::ros::cdr::Cursor;
use lacuna_simulate::case::{CaseOptions, draw_case};
use lacuna_simulate::{simulate, write_csv};
use lacuna_tests::{Bench, report, workspace};
use std::path::Path;

/// Recordings of one robot: five clean ones to identify from and `clean.csv`, and `load.csv` with a payload.
fn folder() -> Bench {
    let bench = Bench::new();
    for (ids, names) in [(vec![], vec!["a", "b", "c", "d", "e", "clean"]), (vec!["payload".to_owned()], vec!["load"])] {
        let options = CaseOptions {
            effects: ids.len(),
            ids,
            severity: [1.0, 1.0],
            mass_error: 0.01,
            trajectories: 6,
            duration_s: 4.0,
            ..CaseOptions::default()
        };
        let case = draw_case(4, &options).expect("case");
        let simulation = simulate(&case.robot, None, &case.config).expect("simulation");
        bench.write("robot.toml", &toml::to_string(&case.robot).expect("robot file"));
        // The payload is carried in some recordings only.
        let carried = simulation
            .recordings
            .iter()
            .filter(|r| names.len() > 1 || simulation.truth.events.get(&r.name).is_some_and(|e| !e.is_empty()));
        for (name, recording) in names.iter().zip(carried) {
            let mut csv = Vec::new();
            write_csv(recording, &mut csv).expect("csv");
            bench.write(&format!("{name}.csv"), &String::from_utf8(csv).expect("text"));
        }
    }
    bench
}

/// Per message of `/monitor`: (watched, alarm) of every joint, read with the `mcap` crate.
fn alarms(path: &Path) -> Vec<(Vec<bool>, Vec<bool>)> {
    let bytes = std::fs::read(path).expect("recording");
    let mut out = Vec::new();
    for message in mcap::MessageStream::new(&bytes).expect("an MCAP file") {
        let message = message.expect("a message");
        if message.channel.topic != "/monitor" {
            continue;
        }
        let schema = message.channel.schema.as_ref().expect("a schema");
        assert_eq!(schema.name, "lacuna_msgs/msg/ResidualWatch");
        let read = || -> Option<(Vec<bool>, Vec<bool>)> {
            let mut cursor = Cursor::new(&message.data)?;
            cursor.header()?;
            cursor.strings()?;
            for _ in 0..3 {
                cursor.numbers()?;
            }
            let mut list = || -> Option<Vec<bool>> {
                let n = cursor.u32()?;
                (0..n).map(|_| cursor.u8().map(|b| b == 1)).collect()
            };
            Some((list()?, list()?))
        };
        out.push(read().expect("a ResidualWatch"));
    }
    out
}

#[test]
fn a_load_that_the_model_does_not_know_raises_an_alarm_in_the_recording() {
    let bench = folder();
    let identify = ["identify", "--robot", "robot.toml", "--out", "model", "a.csv", "b.csv", "c.csv", "d.csv", "e.csv"];
    let done = bench.lacuna(&identify);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let graph = workspace().join("launch/replay.toml").display().to_string();
    for (name, expected) in [("clean", false), ("load", true)] {
        let (recording, out) = (format!("recording={name}.csv"), format!("out={name}.mcap"));
        let sets = [recording.as_str(), "robot=robot.toml", "model=model/model.toml", out.as_str()];
        let mut args = vec!["up", &graph, "--json"];
        sets.iter().for_each(|s| args.extend(["--set", s]));
        let report = report(&bench.lacuna(&args));
        assert_eq!(report["lost"], 0);
        let found = alarms(&bench.path().join(format!("{name}.mcap")));
        assert_eq!(found.len() as u64, report["samples"].as_u64().expect("samples"));
        assert!(found.iter().all(|(watched, _)| watched == &[true; 3]), "{name}: every joint is watched");
        assert_eq!(found.iter().any(|(_, alarm)| alarm.contains(&true)), expected, "{name}");
    }
}
