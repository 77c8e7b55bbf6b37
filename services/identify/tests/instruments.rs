//! Coarse encoders: noise in the accelerations biases what least squares finds of the inertias; instruments do not.

mod common;

use common::ARM;
use lacuna_identify::split::Span;
use lacuna_identify::{Instruments, Options, Outcome, identify_recordings};
use lacuna_interfaces::{Recording, RobotFile};
use lacuna_simulate::config::{SimulationConfig, TrajectoryGroup};
use lacuna_simulate::reference::Kinds;
use lacuna_simulate::simulate;

fn robot() -> RobotFile {
    RobotFile::parse(ARM).unwrap()
}

/// Recordings whose positions are read in steps of `step_rad`.
fn recordings(step_rad: f64) -> Vec<Recording> {
    let group = |kind, count| TrajectoryGroup { kind, duration_s: 10.0, count, intensity: 0.8 };
    let config =
        SimulationConfig { seed: 5, trajectories: vec![group(Kinds::Fourier, 3)], ..SimulationConfig::default() };
    let mut all = simulate(&robot(), None, &config).unwrap().recordings;
    for r in &mut all {
        r.q_rad.iter_mut().flatten().for_each(|q| *q = (*q / step_rad).round() * step_rad);
    }
    all
}

fn run(recordings: &[Recording], instruments: Instruments) -> Outcome {
    let robot = robot();
    let body = lacuna_physics::build(&robot, None).unwrap();
    let options = Options { instruments, ..Options::default() };
    let whole: Vec<Span> = (0..recordings.len()).map(Span::whole).collect();
    let ranges = (whole.clone(), whole);
    identify_recordings(&options, &robot, body.as_ref(), recordings.to_vec(), &ranges, &mut |_, _| ()).unwrap()
}

/// (symbol, value, half width, truth) of every rigid-body parameter: the plant is the robot file's.
fn rigid(outcome: &Outcome) -> Vec<(String, f64, f64, f64)> {
    let all = outcome.identification.parameters.iter().filter(|p| p.nominal.is_some());
    all.map(|p| (p.symbol.clone(), p.value, 0.5 * (p.ci95[1] - p.ci95[0]), p.nominal.unwrap())).collect()
}

#[test]
fn a_coarse_encoder_biases_least_squares_and_not_instruments() {
    for step in [1e-3, 2e-3] {
        let coarse = recordings(step);
        let [plain, with, auto] = [Instruments::Off, Instruments::On, Instruments::Auto].map(|i| run(&coarse, i));
        assert!(plain.identification.instruments.is_none());
        let check = with.identification.instruments.clone().unwrap();
        eprintln!("{step} rad: {check:?}");
        let mut biased = 0;
        for ((symbol, ls, half, truth), (_, iv, iv_half, _)) in rigid(&plain).into_iter().zip(rigid(&with)) {
            eprintln!("{symbol}: truth {truth:.4}, plain {ls:.4} ± {half:.4}, instruments {iv:.4} ± {iv_half:.4}");
            biased += usize::from(symbol.starts_with('I') && (ls - truth).abs() > 1.3 * half);
            assert!((iv - truth).abs() < 1.3 * iv_half, "{symbol}: {iv} ± {iv_half}, truth {truth}");
        }
        assert!(biased >= 2, "least squares is wrong about {biased} inertias");
        // The check says so, and the automatic choice follows it.
        assert!(check.statistic.abs() > check.threshold);
        assert_eq!(rigid(&auto), rigid(&with));
        assert!(auto.identification.warnings.iter().any(|w| w.starts_with("encoder noise")));
    }
}

#[test]
fn a_fine_encoder_needs_no_instruments() {
    let fine = recordings(1e-6);
    assert!(run(&fine, Instruments::Auto).identification.instruments.is_none());
    let check = run(&fine, Instruments::On).identification.instruments.unwrap();
    eprintln!("{check:?}");
    assert!(check.used && check.statistic.abs() < 1.5 * check.threshold);
}
