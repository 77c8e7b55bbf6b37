//! The payload under an identified model: of an independent simulator's recordings (whose answers are read here only), and
//! of simulated robots with other masses, with times that are known and with times that are found.

mod common;

use common::ARM;
use common::{files, shared, whole};
use lacuna_identify::payload::{Known, Options as PayloadOptions, PayloadRun, payload};
use lacuna_identify::{Method, Options, identify};
use lacuna_interfaces::{ModelFile, RobotFile, StageContext};
use lacuna_simulate::config::{FrictionConfig, SimulationConfig, TrajectoryGroup};
use lacuna_simulate::demo::DEMO_ROBOT;
use lacuna_simulate::reference::Kinds;
use lacuna_simulate::{TrueEffect, simulate};
use std::path::{Path, PathBuf};

fn estimate(path: &Path, robot: &RobotFile, model: &ModelFile, known: Vec<Known>) -> PayloadRun {
    let context = StageContext { robot, urdf: None, model: Some(model) };
    payload(path, &context, &PayloadOptions { known, ..PayloadOptions::default() }).unwrap()
}

fn say(what: &str, run: &PayloadRun) {
    for i in &run.measured {
        eprintln!(
            "{what} {}: {:.3?} to {:.3?} s, {:.3?} kg of {:.3?}, settled after {:.3?}, zero after {:.3?}",
            run.file, i.picked_s, i.placed_s, i.mass_kg, i.known_kg, i.settled_after_s, i.zero_after_s
        );
    }
}

#[test]
fn an_independent_simulators_payload_is_known_within_three_tenths_of_a_second() {
    let Some(dir) = shared("delta_concealed") else { return };
    let folder = dir.join("cases/case_09113");
    let key = std::fs::read_to_string(dir.join("keys/case_09113.json")).unwrap();
    let key: serde_json::Value = serde_json::from_str(&key).unwrap();
    let robot = RobotFile::parse(&std::fs::read_to_string(folder.join("robot.toml")).unwrap()).unwrap();
    // The one recording without a payload identifies the model.
    let empty = folder.join("traj_01.csv");
    let options = Options { robot: folder.join("robot.toml"), recordings: vec![empty], ..Options::default() };
    let model = identify(&options, &mut |_, _| ()).unwrap().model;
    let (mut worst_pick, mut worst_place, mut count) = (0.0f64, 0.0f64, 0);
    for path in files(&folder, "traj_0").into_iter().skip(1) {
        let name = path.file_name().unwrap().to_str().unwrap();
        let number = |e: &serde_json::Value, key: &str| e[key].as_f64().unwrap();
        let of = |e: &serde_json::Value| Known {
            from_s: number(e, "t_on"),
            to_s: number(e, "t_off"),
            mass_kg: Some(number(e, "mass")),
        };
        let known: Vec<Known> = key["events"][name].as_array().unwrap().iter().map(of).collect();
        let run = estimate(&path, &robot, &model, known.clone());
        say("09113", &run);
        assert_eq!(run.measured.len(), known.len());
        for i in &run.measured {
            let (mass, known) = (i.mass_kg.expect("a mass"), i.known_kg.unwrap());
            assert!((mass / known - 1.0).abs() < 0.03, "{name}: {mass} kg of {known}");
            worst_pick = worst_pick.max(i.settled_after_s.expect("settles after the pick"));
            worst_place = worst_place.max(i.zero_after_s.expect("is back to zero after the place"));
            count += 1;
        }
        // Without the times: as many, of the same mass, at nearly the same time.
        let found = estimate(&path, &robot, &model, Vec::new());
        say("  found", &found);
        assert_eq!(found.measured.len(), known.len(), "{name}");
        for (i, k) in found.measured.iter().zip(&known) {
            assert!((i.mass_kg.unwrap() / k.mass_kg.unwrap() - 1.0).abs() < 0.03, "{i:?}");
            assert!((i.picked_s.unwrap() - k.from_s).abs() < 0.05, "{i:?} {k:?}");
            assert!((i.placed_s.unwrap() - k.to_s).abs() < 0.05, "{i:?} {k:?}");
        }
    }
    eprintln!("09113: slowest to settle {worst_pick:.3} s, slowest back to zero {worst_place:.3} s");
    assert!(count == 7 && worst_pick <= 0.3 && worst_place <= 0.3, "{count} {worst_pick} {worst_place}");
}

/// Free motions without and a pick-and-place with a payload, of the same robot; the model comes from the former.
fn carried(text: &str, mass_kg: f64, seed: u64, method: Method) -> (PayloadRun, Vec<Known>) {
    let robot = RobotFile::parse(text).unwrap();
    let group = |kind, count| TrajectoryGroup { kind, duration_s: 6.0, count, intensity: 0.8 };
    let free = SimulationConfig {
        seed,
        trajectories: vec![group(Kinds::Fourier, 2), group(Kinds::PointToPoint, 2)],
        friction: FrictionConfig::default(),
        ..SimulationConfig::default()
    };
    let mut with = free.clone();
    with.trajectories = vec![group(Kinds::PickPlace, 1)];
    with.effects.push(TrueEffect::new("payload", &[], &[("m", mass_kg)]));
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("robot.toml"), text).unwrap();
    let csv = |paths: Vec<PathBuf>| paths.into_iter().filter(|p| p.extension().is_some_and(|e| e == "csv")).collect();
    let recordings: Vec<PathBuf> = csv(simulate(&robot, None, &free).unwrap().write(&dir.path().join("free")).unwrap());
    let simulation = simulate(&robot, None, &with).unwrap();
    let carrying: Vec<PathBuf> = csv(simulation.write(&dir.path().join("carrying")).unwrap());
    let train = recordings.iter().skip(1).map(whole).collect();
    let options = Options {
        robot: dir.path().join("robot.toml"),
        train,
        test: vec![whole(&recordings[0])],
        method,
        ..Options::default()
    };
    let model = identify(&options, &mut |_, _| ()).unwrap().model;
    let known = |e: &lacuna_simulate::EventTruth| Known { from_s: e.t_on, to_s: e.t_off, mass_kg: Some(e.mass) };
    let known: Vec<Known> = simulation.truth.events.values().flatten().map(known).collect();
    let run = estimate(&carrying[0], &robot, &model, known.clone());
    say("known", &run);
    let found = estimate(&carrying[0], &robot, &model, Vec::new());
    say("found", &found);
    assert_eq!(found.measured.len(), known.len(), "{found:?}");
    (run, known)
}

#[test]
fn other_masses_and_another_robot() {
    for (text, mass, seed) in [(DEMO_ROBOT, 0.8, 11), (DEMO_ROBOT, 6.0, 12), (ARM, 1.0, 13)] {
        let (run, known) = carried(text, mass, seed, Method::Pooled);
        assert!(!known.is_empty() && run.measured.len() == known.len());
        for i in run.measured.iter().chain(&run.simulated) {
            assert!((i.mass_kg.unwrap() / mass - 1.0).abs() < 0.03, "{i:?}");
            assert!(i.settled_after_s.is_some_and(|s| s <= 0.3), "{i:?}");
        }
        // What the payload explains is gone from the error.
        let [without, with] = &run.table2[..] else { panic!("two columns") };
        for (a, b) in without.std_nm.iter().zip(&with.std_nm) {
            assert!(b < a, "{without:?} {with:?}");
        }
    }
}

#[test]
fn an_empty_gripper_is_no_payload() {
    let robot = RobotFile::parse(DEMO_ROBOT).unwrap();
    let config = SimulationConfig {
        seed: 5,
        trajectories: vec![TrajectoryGroup { kind: Kinds::Fourier, duration_s: 6.0, count: 3, intensity: 0.8 }],
        ..SimulationConfig::default()
    };
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("robot.toml"), DEMO_ROBOT).unwrap();
    let paths: Vec<PathBuf> = simulate(&robot, None, &config).unwrap().write(dir.path()).unwrap();
    let csv: Vec<PathBuf> = paths.into_iter().filter(|p| p.extension().is_some_and(|e| e == "csv")).collect();
    let options = Options { robot: dir.path().join("robot.toml"), recordings: csv[..2].to_vec(), ..Options::default() };
    let model = identify(&options, &mut |_, _| ()).unwrap().model;
    let run = estimate(&csv[2], &robot, &model, Vec::new());
    assert!(run.measured.is_empty(), "{run:?}");
    assert!(lacuna_identify::payload::warnings(&run).iter().any(|w| w.contains("no payload found")));
    // The nominal model lacks friction: nothing may fail, whatever is found.
    let nominal = ModelFile::nominal(&robot);
    estimate(&csv[2], &robot, &nominal, vec![Known { from_s: -5.0, to_s: 99.0, mass_kg: Some(1.0) }]);
}
