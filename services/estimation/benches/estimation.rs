//! ns per sample, each beside a baseline that runs in the same process: `cargo bench -p lacuna-estimation`.
//!
//! A figure is the least of several medians: the median discards the scheduler, the least discards what
//! other processes did to the cache meanwhile.

use lacuna_estimation::filter::ZeroPhase;
use lacuna_estimation::kalman::{FixedLag, Lag, MotionModel, Noise, Settings, Smoothed, smooth, smooth_into};
use lacuna_estimation::least_squares::{Gram, Statistics, Tsqr, accumulate};
use nalgebra::{Matrix3, RowVector3, Vector3};
use std::hint::black_box;
use std::time::Instant;

const JOINTS: usize = 3;

/// Seconds of one call of `work`: least of 3 medians of 5.
fn seconds(mut work: impl FnMut()) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..3 {
        let mut times: Vec<f64> = (0..5)
            .map(|_| {
                let start = Instant::now();
                work();
                start.elapsed().as_secs_f64()
            })
            .collect();
        times.sort_by(f64::total_cmp);
        best = best.min(times[2]);
    }
    best
}

fn line(what: &str, ns: f64, baseline: &str, baseline_ns: f64) {
    println!("{what:<58}{ns:>10.1} ns   {baseline:<34}{baseline_ns:>10.1} ns   {:>6.1} x", baseline_ns / ns);
}

/// The textbook: predict, update, keep everything, then Rauch-Tung-Striebel with a matrix inverse a sample.
fn textbook(t: &[f64], z: &[f64], q: f64, r: f64) -> Vec<(Vector3<f64>, Matrix3<f64>)> {
    let h = RowVector3::new(1.0, 0.0, 0.0);
    let model = |dt: f64| {
        let f = Matrix3::new(1.0, dt, 0.5 * dt * dt, 0.0, 1.0, dt, 0.0, 0.0, 1.0);
        let g = Matrix3::new(
            dt.powi(5) / 20.0,
            dt.powi(4) / 8.0,
            dt.powi(3) / 6.0,
            dt.powi(4) / 8.0,
            dt.powi(3) / 3.0,
            dt.powi(2) / 2.0,
            dt.powi(3) / 6.0,
            dt.powi(2) / 2.0,
            dt,
        );
        (f, g * q)
    };
    let mut x = Vector3::new(z[0], 0.0, 0.0);
    let mut p = Matrix3::from_diagonal(&Vector3::new(r, 1e2, 1e6));
    let mut filtered = vec![(x, p)];
    let mut predicted = vec![(x, p)];
    for k in 1..t.len() {
        let (f, g) = model(t[k] - t[k - 1]);
        x = f * x;
        p = f * p * f.transpose() + g;
        predicted.push((x, p));
        let s = (h * p * h.transpose())[(0, 0)] + r;
        let gain = p * h.transpose() / s;
        x += gain * (z[k] - x[0]);
        p = (Matrix3::identity() - gain * h) * p;
        filtered.push((x, p));
    }
    let mut out = filtered.clone();
    for k in (0..t.len() - 1).rev() {
        let (f, _) = model(t[k + 1] - t[k]);
        let c = filtered[k].1 * f.transpose() * predicted[k + 1].1.try_inverse().unwrap_or_else(Matrix3::zeros);
        out[k].0 = filtered[k].0 + c * (out[k + 1].0 - predicted[k + 1].0);
        out[k].1 = filtered[k].1 + c * (out[k + 1].1 - predicted[k + 1].1) * c.transpose();
    }
    out
}

fn positions(t: &[f64]) -> Vec<Vec<f64>> {
    let noise = |k: usize| ((k * 7919) % 1009) as f64 / 1009.0 - 0.5;
    (0..JOINTS)
        .map(|j| {
            t.iter().enumerate().map(|(k, t)| 0.6 * (5.0 * t + j as f64).sin() + 6e-7 * noise(k * 3 + j)).collect()
        })
        .collect()
}

fn smoother() {
    let n = 200_000;
    let regular: Vec<f64> = (0..n).map(|k| k as f64 * 1e-3).collect();
    let irregular: Vec<f64> = (0..n).map(|k| k as f64 * 1e-3 + 2e-4 * ((k * 31) % 17) as f64 / 17.0).collect();
    let model = MotionModel::ConstantAcceleration;
    let noise = Noise::from_bandwidth(model, 80.0, 2e-7, 1e-3);
    let other = |f: f64| Noise { process: noise.process * f, ..noise };
    let q = positions(&regular);
    let views: Vec<&[f64]> = q.iter().map(Vec::as_slice).collect();
    let r = noise.measurement_sd * noise.measurement_sd;
    let few = n / 20;
    let base = seconds(|| {
        for q in &q {
            black_box(textbook(&regular[..few], &q[..few], noise.process, r));
        }
    }) / few as f64
        * 1e9;
    let textbook_name = "textbook RTS, nalgebra";
    let mut out = Smoothed::default();
    for (what, t, noises, steady) in [
        ("offline, 3 joints, regular, one q/r", &regular, vec![noise; JOINTS], true),
        ("offline, 3 joints, regular, a q/r each", &regular, vec![noise, other(2.0), other(3.0)], true),
        ("offline, 3 joints, regular, exact path", &regular, vec![noise; JOINTS], false),
        ("offline, 3 joints, irregular, one q/r", &irregular, vec![noise; JOINTS], true),
        ("offline, 3 joints, irregular, a q/r each", &irregular, vec![noise, other(2.0), other(3.0)], true),
    ] {
        let settings = Settings { steady_state: steady, ..Settings::new(model, noises) };
        let ns = seconds(|| drop(black_box(smooth_into(&settings, t, &views, &mut out)))) / n as f64 * 1e9;
        line(what, ns, textbook_name, base);
    }
    let settings = Settings::new(model, vec![noise; JOINTS]);
    let ns = seconds(|| drop(black_box(smooth(&settings, &regular, &views)))) / n as f64 * 1e9;
    line("offline, 3 joints, regular, one q/r, fresh memory", ns, textbook_name, base);
    let long: Vec<f64> = (0..1_000_000).map(|k| k as f64 * 1e-3).collect();
    let long_q = positions(&long);
    let long_views: Vec<&[f64]> = long_q.iter().map(Vec::as_slice).collect();
    let whole = seconds(|| drop(black_box(smooth(&settings, &long, &long_views))));
    println!("{:<58}{whole:>10.3} s", "offline, 1e6 samples x 3 joints, one core, fresh memory");
    let settings = Settings::new(MotionModel::ConstantJerk, vec![noise; JOINTS]);
    let ns = seconds(|| drop(black_box(smooth_into(&settings, &regular, &views, &mut out)))) / n as f64 * 1e9;
    line("offline, 3 joints, regular, constant jerk", ns, textbook_name, base);
    for (what, t, lag, noises) in [
        ("stream, 3 joints, regular, lag 25", &regular, 25, vec![noise; JOINTS]),
        ("stream, 3 joints, regular, lag 100", &regular, 100, vec![noise; JOINTS]),
        ("stream, 3 joints, regular, lag 25, a q/r each", &regular, 25, vec![noise, other(2.0), other(3.0)]),
        ("stream, 3 joints, irregular, lag 25", &irregular, 25, vec![noise; JOINTS]),
        ("stream, 3 joints, irregular, lag 25, a q/r each", &irregular, 25, vec![noise, other(2.0), other(3.0)]),
    ] {
        let settings = Settings::new(model, noises);
        let mut worst = 0.0f64;
        let ns = seconds(|| {
            let Ok(mut stream) = FixedLag::new(&settings, Lag::Samples(lag)) else { return };
            for (k, t) in t.iter().enumerate() {
                let sample = [q[0][k], q[1][k], q[2][k]];
                stream.push((t * 1e9) as i64, &sample, &mut |e| worst = worst.max(e.joints[0].qdd));
            }
        }) / n as f64
            * 1e9;
        black_box(worst);
        line(what, ns, textbook_name, base);
    }
}

fn filters() {
    let n = 100_000;
    let Ok(filter) = ZeroPhase::butterworth(4, 40.0, 1000.0) else { return };
    let mut data: Vec<Vec<f64>> =
        (0..8).map(|c| (0..n).map(|k| ((k * (c + 3)) as f64 * 1e-2).sin()).collect()).collect();
    let single = seconds(|| data.iter_mut().for_each(|x| drop(filter.apply_in_place(x)))) / (8 * n) as f64 * 1e9;
    let together = seconds(|| {
        let mut views: Vec<&mut [f64]> = data.iter_mut().map(Vec::as_mut_slice).collect();
        drop(filter.apply_columns(&mut views));
    }) / (8 * n) as f64
        * 1e9;
    line("zero-phase order 4, per value, columns together", together, "one by one", single);
}

fn regression() {
    let (rows, p) = (3_000_000, 20);
    let block = 10_000;
    let blocks = rows / block;
    // The time is of filling the rows too, as identification does it: a few operations an entry.
    let fill = |b: usize, x: &mut Vec<f64>, y: &mut Vec<f64>| {
        x.clear();
        y.clear();
        for k in 0..block {
            let s = ((b * block + k) % 10_007) as f64 * 1e-4;
            x.extend((0..p).map(|j| (s + j as f64 * 0.37) * (s - 0.5 * j as f64)));
            y.push(s);
        }
    };
    let gram = seconds(|| {
        let sums = accumulate::<Gram, _, _>(blocks, p, |b, g| {
            let (mut x, mut y) = (Vec::new(), Vec::new());
            fill(b, &mut x, &mut y);
            g.add_rows(&x, &y, None)
        });
        black_box(sums.ok().and_then(|s| s.total()));
    }) / rows as f64
        * 1e9;
    let few = blocks / 10;
    let qr = seconds(|| {
        let sums = accumulate::<Tsqr, _, _>(few, p, |b, g| {
            let (mut x, mut y) = (Vec::new(), Vec::new());
            fill(b, &mut x, &mut y);
            g.add_rows(&x, &y, None)
        });
        black_box(sums.ok().and_then(|s| s.total()));
    }) / (few * block) as f64
        * 1e9;
    line("normal equations, 20 columns, per row, all cores", gram, "QR (Tsqr), all cores", qr);
    println!("{:<58}{:>10.2} s", "1e6 samples x 20 parameters x 3 joints accumulated", gram * rows as f64 * 1e-9);
}

fn main() {
    smoother();
    filters();
    regression();
}
