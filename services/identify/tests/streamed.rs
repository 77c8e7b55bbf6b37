//! The fit on sums of bounded size against a fit of the whole regressor in memory by QR, and nuisances that must not be
//! learned from what a fold holds out.

use lacuna_estimation::least_squares::weighted_least_squares;
use lacuna_identify::base::{Structure, structure};
use lacuna_identify::columns::columns;
use lacuna_identify::rows::{Rows, rows};
use lacuna_identify::split::Span;
use lacuna_identify::{Delay, Holdout, Options, Signal, identify_recordings};
use lacuna_interfaces::{Recording, RobotFile};
use lacuna_physics::RigidBody;
use lacuna_simulate::config::{SimulationConfig, TrajectoryGroup};
use lacuna_simulate::reference::Kinds;
use lacuna_simulate::simulate;
use nalgebra::{DMatrix, DVector};

const ROBOT: &str = "kind = \"delta\"\nname = \"test\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n[mass]\n\
    platform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\nrotor_inertia = 0.06\n[drive]\ngear_ratio = 33\n\
    encoder_bits = 20\nsample_rate_hz = 1000\n";

/// Recordings of the robot's twin; long ones, so that a recording is streamed in several parts.
fn recordings(robot: &RobotFile, seed: u64, count: u32, duration_s: f64) -> Vec<Recording> {
    let group = |kind, count| TrajectoryGroup { kind, duration_s, count, intensity: 0.8 };
    let trajectories = vec![group(Kinds::Fourier, count), group(Kinds::PointToPoint, 1)];
    simulate(robot, None, &SimulationConfig { seed, trajectories, ..SimulationConfig::default() }).unwrap().recordings
}

/// Fitted rows of all joints as one matrix, and the joint of each.
fn matrix(structure: &Structure, rows: &Rows) -> (DMatrix<f64>, DVector<f64>, Vec<usize>) {
    let p = structure.base.len();
    let (mut x, mut y, mut of) = (Vec::new(), Vec::new(), Vec::new());
    for (j, active) in structure.active.iter().enumerate() {
        let joint = &rows.joints[j];
        for k in (0..rows.len()).filter(|&k| joint.fitted[k]) {
            let at = x.len();
            x.resize(at + p, 0.0);
            active.iter().enumerate().for_each(|(slot, b)| x[at + b] = joint.x[k * active.len() + slot]);
            y.push(joint.y[k]);
            of.push(j);
        }
    }
    (DMatrix::from_row_slice(y.len(), p, &x), DVector::from_vec(y), of)
}

/// Root mean square of `e` per joint, weighted.
fn scale(e: &DVector<f64>, of: &[usize], h: &[f64]) -> Vec<f64> {
    (0..3)
        .map(|j| {
            let own = || (0..of.len()).filter(move |&k| of[k] == j);
            (own().map(|k| h[k] * e[k] * e[k]).sum::<f64>() / own().map(|k| h[k]).sum::<f64>()).sqrt()
        })
        .collect()
}

/// The same steps on the whole matrix: weights of the torque's size, of the noise's, then two rounds of Huber's.
fn in_memory(structure: &Structure, rows: &Rows, robust: bool) -> DVector<f64> {
    let (x, y, of) = matrix(structure, rows);
    let mut h = vec![1.0; of.len()];
    let mean: Vec<f64> = (0..3)
        .map(|j| {
            let own: Vec<f64> = (0..of.len()).filter(|&k| of[k] == j).map(|k| y[k]).collect();
            own.iter().sum::<f64>() / own.len() as f64
        })
        .collect();
    let mut sigma = scale(&DVector::from_fn(y.len(), |k, _| y[k] - mean[of[k]]), &of, &h);
    let solve = |sigma: &[f64], h: &[f64]| {
        let w: Vec<f64> = (0..of.len()).map(|k| h[k] / (sigma[of[k]] * sigma[of[k]])).collect();
        weighted_least_squares(&x, &y, &w).unwrap().beta
    };
    let mut beta = solve(&sigma, &h);
    sigma = scale(&(&y - &x * &beta), &of, &h);
    beta = solve(&sigma, &h);
    sigma = scale(&(&y - &x * &beta), &of, &h);
    for _ in 0..if robust { 2 } else { 0 } {
        let e = &y - &x * &beta;
        h = (0..of.len()).map(|k| (2.5 * sigma[of[k]] / e[k].abs()).min(1.0)).collect();
        beta = solve(&sigma, &h);
        sigma = scale(&(&y - &x * &beta), &of, &h);
    }
    solve(&sigma, &h)
}

#[test]
fn the_streamed_fit_is_the_fit_in_memory() {
    let robot = RobotFile::parse(ROBOT).unwrap();
    let body: Box<dyn RigidBody> = lacuna_physics::build(&robot, None).unwrap();
    let recordings = recordings(&robot, 21, 2, 40.0);
    let structure = structure(body.as_ref(), &robot, columns(body.as_ref(), Signal::Motor, "Nm")).unwrap();
    let whole: Vec<Span> = (0..recordings.len()).map(Span::whole).collect();
    // All rows kept; rows of the first part, and of the later ones those with a large residual; all computed anew.
    for (robust, row_memory) in [(false, 64 << 20), (true, 64 << 20), (true, 3 << 20), (true, 1)] {
        let mut options = Options { robust, row_memory, delay: Delay::Off, ..Options::default() };
        options.conditioning.bristle = false;
        let plan = options.conditioning.plan(&recordings.iter().collect::<Vec<_>>()).unwrap();
        let rows = rows(body.as_ref(), &robot, &structure, &plan, &recordings).unwrap();
        assert!(rows.len() > 2 * 8192, "several parts: {}", rows.len());
        let beta = in_memory(&structure, &rows, robust);
        let ranges = (whole.clone(), whole.clone());
        let streamed =
            identify_recordings(&options, &robot, body.as_ref(), recordings.clone(), &ranges, &mut |_, _| ())
                .unwrap()
                .identification;
        assert_eq!(
            streamed.rows,
            rows.joints.iter().map(|j| j.fitted.iter().filter(|f| **f).count()).collect::<Vec<_>>()
        );
        let mut compared = 0;
        for p in &streamed.parameters {
            let b = structure.base.iter().position(|b| structure.columns[b.column].symbol == p.symbol).unwrap();
            let half = 0.5 * (p.ci95[1] - p.ci95[0]);
            let off = (p.value - beta[b]).abs() / half;
            // Parts overlap by ten periods of the band, and outliers are weighed in single precision.
            assert!(
                off < 1e-3,
                "{} = {} against {} (robust: {robust}, memory: {row_memory})",
                p.symbol,
                p.value,
                beta[b]
            );
            compared += 1;
        }
        assert!(compared >= 12, "{compared}");
    }
}

#[test]
fn a_folds_delay_comes_from_its_training_data_alone() {
    let robot = RobotFile::parse(ROBOT).unwrap();
    let body = lacuna_physics::build(&robot, None).unwrap();
    let mut recordings = recordings(&robot, 7, 1, 10.0);
    // The torque of the second recording comes 0.8 ms late.
    for tau in &mut recordings[1].tau_nm {
        *tau = (0..tau.len()).map(|k| if k == 0 { tau[0] } else { 0.2 * tau[k] + 0.8 * tau[k - 1] }).collect();
    }
    let options = Options { holdout: Some(Holdout::Recordings), ..Options::default() };
    let ranges = (Vec::new(), Vec::new());
    let out = identify_recordings(&options, &robot, body.as_ref(), recordings, &ranges, &mut |_, _| ()).unwrap();
    let delays = &out.identification.held_out.fold_delays_s;
    eprintln!("delays by fold {delays:?}, over both {:?}", out.identification.delay);
    // The first fold trains on the late recording, the second on the one that is not.
    assert!((delays[0] - 0.8e-3).abs() < 0.1e-3 && delays[1].abs() < 0.05e-3, "{delays:?}");
}
