//! Instruments from the smoothed and from the re-simulated motion, over many simulated arms whose controller reads a coarse
//! encoder: bias of the inertias in standard errors, and their error. Prints the table of docs/IDENTIFICATION.md.

use lacuna_identify::split::Span;
use lacuna_identify::{InstrumentMotion, Instruments, Options, identify_recordings};
use lacuna_interfaces::{Recording, RobotFile};
use lacuna_simulate::config::{NoiseConfig, SimulationConfig, TrajectoryGroup};
use lacuna_simulate::reference::Kinds;
use lacuna_simulate::simulate;
use std::collections::BTreeMap;

const ARM: &str = "kind = \"serial\"\nname = \"arm\"\njoints = [\"a\", \"b\"]\n[env]\ngravity = [9.81, 0.0, 0.0]\n\
    [[dh]]\na = 0.3\n[[dh]]\na = 0.25\n\
    [[link]]\nmass = 2.0\ncom = [-0.1, 0.0, 0.0]\ninertia = [0.01, 0.0, 0.0, 0.02, 0.0, 0.02]\nrotor_inertia = 0.1\n\
    [[link]]\nmass = 1.5\ncom = [-0.1, 0.0, 0.0]\ninertia = [0.01, 0.0, 0.0, 0.015, 0.0, 0.015]\nrotor_inertia = 0.05\n\
    [drive]\ngear_ratio = 50\nencoder_bits = 20\nsample_rate_hz = 1000\n\
    [columns]\nreference = [\"qref1\", \"qref2\"]\n";

fn robot() -> RobotFile {
    RobotFile::parse(ARM).unwrap()
}

/// Three Fourier motions; the controller and the log read positions in steps of `step_rad`.
fn recordings(seed: u64, step_rad: f64) -> Vec<Recording> {
    let mut config = SimulationConfig {
        seed,
        trajectories: vec![TrajectoryGroup { kind: Kinds::Fourier, duration_s: 10.0, count: 3, intensity: 0.8 }],
        noise: NoiseConfig { encoder_step_rad: Some(step_rad), encoder_steps: 0.5, ..NoiseConfig::default() },
        ..SimulationConfig::default()
    };
    config.log.reference = true;
    simulate(&robot(), None, &config).unwrap().recordings
}

/// How an estimate is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum How {
    LeastSquares,
    Smoothed,
    Resimulated,
}

/// (symbol, error, standard error) of every inertia.
fn inertias(recordings: &[Recording], how: How) -> Vec<(String, f64, f64)> {
    let robot = robot();
    let body = lacuna_physics::build(&robot, None).unwrap();
    let instruments = match how {
        How::LeastSquares => Instruments::Off,
        How::Smoothed => Instruments::On,
        How::Resimulated => Instruments::Command,
    };
    let options = Options { instruments, ..Options::default() };
    let whole: Vec<Span> = (0..recordings.len()).map(Span::whole).collect();
    let ranges = (whole.clone(), whole);
    let out =
        identify_recordings(&options, &robot, body.as_ref(), recordings.to_vec(), &ranges, &mut |_, _| ()).unwrap();
    let i = out.identification;
    let motion = i.instruments.as_ref().map(|c| c.motion);
    match how {
        How::LeastSquares => assert_eq!(motion, None),
        How::Smoothed => assert_eq!(motion, Some(InstrumentMotion::Smoothed)),
        How::Resimulated => assert_eq!(motion, Some(InstrumentMotion::Resimulated)),
    }
    let all = i.parameters.iter().filter(|p| p.symbol.starts_with('I') && p.nominal.is_some());
    // 97.5 % of Student's t for so many blocks is 1.98.
    all.map(|p| (p.symbol.clone(), p.value - p.nominal.unwrap(), 0.5 * (p.ci95[1] - p.ci95[0]) / 1.98)).collect()
}

#[derive(Debug, Default, Clone)]
struct Figures {
    /// Error over standard error.
    z: Vec<f64>,
    error: Vec<f64>,
}

fn rms(x: &[f64]) -> f64 {
    (x.iter().map(|v| v * v).sum::<f64>() / x.len().max(1) as f64).sqrt()
}

fn mean(x: &[f64]) -> f64 {
    x.iter().sum::<f64>() / x.len().max(1) as f64
}

fn figures(seeds: std::ops::Range<u64>, step_rad: f64) -> BTreeMap<How, BTreeMap<String, Figures>> {
    let mut out: BTreeMap<How, BTreeMap<String, Figures>> = BTreeMap::new();
    for seed in seeds {
        let recordings = recordings(seed, step_rad);
        for how in [How::LeastSquares, How::Smoothed, How::Resimulated] {
            for (symbol, error, se) in inertias(&recordings, how) {
                let to = out.entry(how).or_default().entry(symbol).or_default();
                to.z.push(error / se);
                to.error.push(error);
            }
        }
    }
    for (how, of) in &out {
        for (symbol, f) in of {
            eprintln!(
                "{:.1} mrad {how:?} {symbol}: bias {:+.2} standard errors, rms {:.2}; error rms {:.5} ({} fits)",
                1e3 * step_rad,
                mean(&f.z),
                rms(&f.z),
                rms(&f.error),
                f.z.len()
            );
        }
    }
    out
}

/// Largest bias over the inertias, in standard errors, and root mean square of all their errors.
fn worst(of: &BTreeMap<String, Figures>) -> (f64, f64) {
    let bias = of.values().map(|f| mean(&f.z).abs()).fold(0.0, f64::max);
    let all: Vec<f64> = of.values().flat_map(|f| f.error.clone()).collect();
    (bias, rms(&all))
}

fn instruments_take_the_bias_off(seeds: std::ops::Range<u64>, steps_rad: &[f64]) {
    for &step_rad in steps_rad {
        let found = figures(seeds.clone(), step_rad);
        let [plain, smoothed, resimulated] =
            [How::LeastSquares, How::Smoothed, How::Resimulated].map(|how| worst(&found[&how]));
        if step_rad < 1e-5 {
            // Nothing is lost where there is nothing to gain.
            assert!(smoothed.1 < 1.2 * plain.1 && resimulated.1 < 1.2 * plain.1, "{found:?}");
        } else {
            assert!(smoothed.0 < 0.4 * plain.0 && resimulated.0 < 0.4 * plain.0, "{found:?}");
            assert!(smoothed.1 < 0.25 * plain.1 && resimulated.1 < 0.25 * plain.1, "{found:?}");
        }
    }
}

#[test]
fn over_four_seeds() {
    instruments_take_the_bias_off(1..5, &[1e-6, 1e-3]);
}

#[test]
#[ignore = "long: 20 seeds at five resolutions"]
fn over_twenty_seeds() {
    instruments_take_the_bias_off(1..21, &[1e-6, 3e-4, 6e-4, 1e-3, 2e-3]);
}

#[test]
fn a_command_that_is_missing_is_said() {
    let mut list = recordings(1, 1e-3);
    list[1].extra.remove("qref2");
    let body = lacuna_physics::build(&robot(), None).unwrap();
    let options = Options { instruments: Instruments::Command, ..Options::default() };
    let none = (Vec::new(), Vec::new());
    let run = |list: Vec<Recording>| {
        identify_recordings(&options, &robot(), body.as_ref(), list, &none, &mut |_, _| ()).unwrap_err().to_string()
    };
    let e = run(list.clone());
    assert!(e.contains("traj_02.csv") && e.contains("found 1 of 2 commanded positions") && !e.contains('\n'), "{e}");
    // A command that is not what the joint does is no instrument.
    let other = list[0].extra["qref1"].iter().rev().copied().collect();
    let mut odd = recordings(1, 1e-3);
    odd[0].extra.insert("qref2".to_owned(), other);
    let e = run(odd);
    assert!(e.contains("traj_01.csv") && e.contains("% of the velocity of joint 2"), "{e}");
}
