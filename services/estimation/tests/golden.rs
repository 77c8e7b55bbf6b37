//! Against numpy and scipy: golden/*.json, written by tests/oracles/estimation_golden.py.

use lacuna_estimation::filter::{Interpolation, ZeroPhase, median_filter, resample};
use lacuna_estimation::kalman::{MotionModel, Noise, Settings, smooth};
use lacuna_estimation::least_squares::{
    Gram, Loss, Statistics, Tsqr, least_squares, newey_west, robust, weighted_least_squares,
};
use nalgebra::{DMatrix, DVector};
use serde_json::Value;

fn golden(name: &str) -> Value {
    let path = format!("{}/tests/golden/{name}.json", env!("CARGO_MANIFEST_DIR"));
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn numbers(v: &Value) -> Vec<f64> {
    v.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn matrix(v: &Value) -> DMatrix<f64> {
    let rows: Vec<Vec<f64>> = v.as_array().unwrap().iter().map(numbers).collect();
    DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
}

#[track_caller]
fn agree(found: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    for (k, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!((a - b).abs() <= tolerance * scale, "entry {k}: found {a}, expected {b}");
    }
}

#[test]
fn filters_agree_with_scipy() {
    let g = golden("filter");
    let x = numbers(&g["x"]);
    for case in g["low_pass"].as_array().unwrap() {
        let number = |key: &str| case[key].as_f64().unwrap();
        let filter = ZeroPhase::butterworth(number("order") as usize, number("cutoff_hz"), number("rate_hz")).unwrap();
        agree(&filter.apply(&x).unwrap(), &numbers(&case["y"]), 1e-10);
    }
    for case in g["median"].as_array().unwrap() {
        let y = median_filter(&x, case["window"].as_u64().unwrap() as usize).unwrap();
        assert_eq!(y, numbers(&case["y"]));
    }
    let (t, v, grid) = (numbers(&g["t"]), numbers(&g["v"]), numbers(&g["grid"]));
    agree(&resample(&t, &v, &grid, Interpolation::Cubic).unwrap(), &numbers(&g["cubic"]), 1e-12);
    agree(&resample(&t, &v, &grid, Interpolation::Linear).unwrap(), &numbers(&g["linear"]), 1e-12);
}

#[test]
fn least_squares_agrees_with_numpy() {
    let g = golden("least_squares");
    let (x, y) = (matrix(&g["x"]), DVector::from_vec(numbers(&g["y"])));
    let covariance = matrix(&g["covariance"]);
    let rows: Vec<f64> = x.transpose().as_slice().to_vec();
    let mut gram = Gram::new(4);
    let mut qr = Tsqr::new(4);
    // In uneven blocks, as a stream would come.
    for (xs, ys) in rows.chunks(4 * 7).zip(y.as_slice().chunks(7)) {
        gram.add_rows(xs, ys, None).unwrap();
        qr.add_rows(xs, ys, None).unwrap();
    }
    for fit in [least_squares(&x, &y).unwrap(), gram.solve().unwrap(), qr.solve().unwrap()] {
        for (found, expected) in fit.beta.iter().zip(numbers(&g["beta"])) {
            assert!((found / expected - 1.0).abs() < 1e-10, "{found} {expected}");
        }
        assert!((fit.sigma / g["sigma"].as_f64().unwrap() - 1.0).abs() < 1e-10);
        assert!((fit.condition / g["condition"].as_f64().unwrap() - 1.0).abs() < 1e-10);
        for (found, expected) in fit.covariance.iter().zip(covariance.iter()) {
            assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
        }
    }
    let weights = numbers(&g["weights"]);
    let weighted = weighted_least_squares(&x, &y, &weights).unwrap();
    let mut gram = Gram::new(4);
    gram.add_rows(&rows, y.as_slice(), Some(&weights)).unwrap();
    for beta in [weighted.beta, gram.solve().unwrap().beta] {
        for (found, expected) in beta.iter().zip(numbers(&g["weighted"])) {
            assert!((found / expected - 1.0).abs() < 1e-10, "{found} {expected}");
        }
    }
    let fit = least_squares(&x, &y).unwrap();
    let hac = newey_west(&fit, &x, &y, g["lags"].as_u64().unwrap() as usize, &[]).unwrap();
    for (found, expected) in hac.iter().zip(matrix(&g["newey_west"]).iter()) {
        assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
    }
}

#[test]
fn huber_agrees_with_direct_minimisation() {
    let g = golden("least_squares");
    let (x, y) = (matrix(&g["x"]), DVector::from_vec(numbers(&g["spoiled"])));
    let fit = robust(&x, &y, Loss::HUBER).unwrap();
    assert!(fit.converged);
    assert!((fit.scale / g["huber_scale"].as_f64().unwrap() - 1.0).abs() < 1e-5);
    for (found, expected) in fit.fit.beta.iter().zip(numbers(&g["huber"])) {
        assert!((found / expected - 1.0).abs() < 1e-5, "{found} {expected}");
    }
    for k in [3, 17, 40] {
        assert!(fit.weights[k] < 0.2, "row {k} weighs {}", fit.weights[k]);
    }
}

#[test]
fn smoother_agrees_with_the_batch_problem() {
    for case in golden("kalman")["cases"].as_array().unwrap() {
        let number = |key: &str| case[key].as_f64().unwrap();
        let model = match case["order"].as_u64().unwrap() {
            3 => MotionModel::ConstantAcceleration,
            _ => MotionModel::ConstantJerk,
        };
        let noise = Noise { process: number("q"), measurement_sd: number("r").sqrt() };
        let (t, z) = (numbers(&case["t"]), numbers(&case["z"]));
        let smoothed = smooth(&Settings::new(model, vec![noise]), &t, &[&z]).unwrap();
        let found = [&smoothed.q_rad[0], &smoothed.qd_rad_s[0], &smoothed.qdd_rad_s2[0]];
        for (signal, expected) in found.into_iter().zip(case["x"].as_array().unwrap()) {
            agree(signal, &numbers(expected), 1e-9);
        }
        let found = [smoothed.sd_q_rad(0), smoothed.sd_qd_rad_s(0), smoothed.sd_qdd_rad_s2(0)];
        for (signal, expected) in found.into_iter().zip(case["sd"].as_array().unwrap()) {
            for (a, b) in signal.iter().zip(numbers(expected)) {
                assert!((a / b - 1.0).abs() < 1e-8, "{a} {b}");
            }
        }
    }
}
