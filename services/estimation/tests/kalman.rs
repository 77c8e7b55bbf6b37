//! The smoother's two ways against each other, and against motion drawn from its own model.

use lacuna_estimation::kalman::{
    CovarianceUpdate, FixedLag, JointState, Lag, MotionModel, Noise, PRIOR_SD, Settings, estimate_noise,
    log_likelihood, smooth, smooth_blocks,
};
use lacuna_estimation::stats::normal_quantile;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};

struct Draw(rand_pcg::Pcg64Mcg);

impl Draw {
    fn new(seed: u64) -> Self {
        Self(rand_pcg::Pcg64Mcg::seed_from_u64(seed))
    }

    fn normal(&mut self) -> f64 {
        normal_quantile(self.0.random_range(1e-15..1.0))
    }

    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        self.0.random_range(low..high)
    }
}

/// Motion of the constant-acceleration model itself: (t, truth [θ, θ̇, θ̈], measurement).
fn motion(noise: Noise, steps: &[f64], seed: u64) -> (Vec<f64>, Vec<[f64; 3]>, Vec<f64>) {
    let mut draw = Draw::new(seed);
    let mut x = [0.3, -0.5, 1.0];
    let mut t = vec![0.0];
    let mut truth = vec![x];
    for &dt in steps {
        // Exact draw of the integrated white jerk: Cholesky factor of Q(dt) for three integrators.
        let (a, b, c) = (draw.normal(), draw.normal(), draw.normal());
        let s = noise.process.sqrt();
        let w = [
            s * dt.powf(2.5) * (a / 20f64.sqrt()),
            s * dt.powf(1.5) * (a * 20f64.sqrt() / 8.0 + b * (1.0 / 3.0 - 20.0 / 64.0f64).sqrt()),
            s * dt.sqrt() * 0.0,
        ];
        let l22 = (1.0 / 3.0 - 20.0 / 64.0f64).sqrt();
        let (l31, l32) = (20f64.sqrt() / 6.0, (0.5 - (20f64.sqrt() / 8.0) * (20f64.sqrt() / 6.0)) / l22);
        let l33 = (1.0 - l31 * l31 - l32 * l32).sqrt();
        let w3 = w[2] + s * dt.sqrt() * (a * l31 + b * l32 + c * l33);
        x = [x[0] + dt * x[1] + 0.5 * dt * dt * x[2] + w[0], x[1] + dt * x[2] + w[1], x[2] + w3];
        t.push(t[t.len() - 1] + dt);
        truth.push(x);
    }
    let z = truth.iter().map(|x| x[0] + noise.measurement_sd * draw.normal()).collect();
    (t, truth, z)
}

fn ns(t: f64) -> i64 {
    (t * 1e9).round() as i64
}

/// Runs the stream; per sample the states of all joints, in order, and the flags (start, gap, short).
fn stream(settings: &Settings, lag: Lag, t: &[f64], q: &[Vec<f64>]) -> Vec<(Vec<JointState>, [bool; 3], i64)> {
    let mut smoother = FixedLag::new(settings, lag).unwrap();
    let mut out = Vec::new();
    let mut emit = |e: &lacuna_estimation::kalman::LagEstimate<'_>| {
        out.push((e.joints.to_vec(), [e.start, e.gap, e.short], e.stamp_ns));
    };
    for k in 0..t.len() {
        let sample: Vec<f64> = q.iter().map(|q| q[k]).collect();
        smoother.push(ns(t[k]), &sample, &mut emit);
    }
    smoother.finish(&mut emit);
    assert_eq!(smoother.pending(), 0);
    assert!(out.iter().zip(t).all(|(o, t)| o.2 == ns(*t)), "in order, none missing");
    out
}

fn close(a: f64, b: f64, scale: f64) -> bool {
    (a - b).abs() <= scale
}

#[test]
fn stream_is_the_offline_smoother_of_what_has_arrived() {
    // Regular, then jittered, then another period, then regular again; two noises, so two groups of gains.
    let mut steps = vec![1e-3; 150];
    let mut draw = Draw::new(9);
    steps.extend((0..60).map(|_| draw.uniform(0.4e-3, 2e-3)));
    steps.extend([2e-3; 130]);
    steps.extend([1e-3; 130]);
    let t: Vec<f64> = std::iter::once(0.0)
        .chain(steps.iter().scan(0.0, |t, dt| {
            *t += (dt * 1e9).round() * 1e-9;
            Some(*t)
        }))
        .collect();
    for model in [MotionModel::ConstantAcceleration, MotionModel::ConstantJerk] {
        let fast = Noise::from_bandwidth(model, 60.0, 1e-5, 1e-3);
        let slow = Noise::from_bandwidth(model, 40.0, 3e-5, 1e-3);
        let settings = Settings::new(model, vec![fast, slow, fast]);
        let q: Vec<Vec<f64>> =
            (0..3).map(|j| t.iter().map(|t| (9.0 * t + f64::from(j)).sin() + 1e-5 * draw.normal()).collect()).collect();
        for lag in [0, 1, 2, 7, 30] {
            let streamed = stream(&settings, Lag::Samples(lag), &t, &q);
            for k in (0..t.len()).step_by(13).chain(t.len() - 5..t.len()) {
                let until = (k + lag + 1).max(model.order()).min(t.len());
                let views: Vec<&[f64]> = q.iter().map(|q| &q[..until]).collect();
                let whole = smooth(&settings, &t[..until], &views).unwrap();
                for j in 0..3 {
                    let s = &streamed[k].0[j];
                    assert!(close(s.q, whole.q_rad[j][k], 1e-11), "{model:?} lag {lag} sample {k}");
                    assert!(close(s.qd, whole.qd_rad_s[j][k], 1e-8), "{model:?} lag {lag} sample {k}");
                    assert!(close(s.qdd, whole.qdd_rad_s2[j][k], 1e-5), "{model:?} lag {lag} sample {k}");
                    assert!(close(s.sd_q / whole.sd_q_rad(j).at(k), 1.0, 1e-7), "{model:?} lag {lag} sample {k}");
                    assert!(
                        close(s.sd_qdd / whole.sd_qdd_rad_s2(j).at(k), 1.0, 1e-7),
                        "{model:?} lag {lag} sample {k}"
                    );
                }
            }
        }
    }
}

#[test]
fn steady_state_and_exact_path_agree() {
    for model in [MotionModel::ConstantAcceleration, MotionModel::ConstantJerk] {
        let t: Vec<f64> = (0..3000).map(|k| f64::from(k) * 1e-3).collect();
        let mut draw = Draw::new(5);
        let q: Vec<f64> = t.iter().map(|t| 0.8 * (7.0 * t).sin() + 3e-7 * draw.normal()).collect();
        for bandwidth in [20.0, 80.0] {
            let noise = Noise::from_bandwidth(model, bandwidth, 3e-7, 1e-3);
            let steady = Settings::new(model, vec![noise]);
            let exact = Settings { steady_state: false, ..steady.clone() };
            let (a, b) = (smooth(&steady, &t, &[&q]).unwrap(), smooth(&exact, &t, &[&q]).unwrap());
            let (qd, qdd) = (0.8 * 7.0, 0.8 * 49.0);
            for k in 0..t.len() {
                assert!(close(a.q_rad[0][k], b.q_rad[0][k], 1e-9 * 0.8), "{k}");
                assert!(close(a.qd_rad_s[0][k], b.qd_rad_s[0][k], 1e-9 * qd), "{k}");
                assert!(close(a.qdd_rad_s2[0][k], b.qdd_rad_s2[0][k], 1e-9 * qdd), "{k}");
                assert!(close(a.sd_q_rad(0).at(k) / b.sd_q_rad(0).at(k), 1.0, 1e-9), "{k}");
                assert!(close(a.sd_qd_rad_s(0).at(k) / b.sd_qd_rad_s(0).at(k), 1.0, 1e-9), "{k}");
                assert!(close(a.sd_qdd_rad_s2(0).at(k) / b.sd_qdd_rad_s2(0).at(k), 1.0, 1e-9), "{k}");
            }
            // On the stream as well, and there the steady path is really taken.
            let lag = Lag::Samples(40);
            let (a, b) =
                (stream(&steady, lag, &t, std::slice::from_ref(&q)), stream(&exact, lag, &t, std::slice::from_ref(&q)));
            for (a, b) in a.iter().zip(&b) {
                assert!(close(a.0[0].qdd, b.0[0].qdd, 1e-9 * qdd) && close(a.0[0].sd_qdd / b.0[0].sd_qdd, 1.0, 1e-9));
            }
            let mut smoother = FixedLag::new(&steady, lag).unwrap();
            t.iter().zip(&q).for_each(|(t, q)| smoother.push(ns(*t), &[*q], &mut |_| ()));
            assert!(smoother.at_steady_state());
        }
    }
}

#[test]
fn jitter_within_the_tolerance_costs_nothing() {
    // Steps that scatter by half the tolerance use the period's gains, but move over the true step.
    let model = MotionModel::ConstantAcceleration;
    let noise = Noise::from_bandwidth(model, 80.0, 3e-7, 1e-3);
    let settings = Settings::new(model, vec![noise]);
    let mut draw = Draw::new(8);
    let mut t = vec![0.0];
    for _ in 0..2000 {
        t.push(t[t.len() - 1] + 1e-3 * (1.0 + 0.5 * settings.period_tolerance * draw.uniform(-1.0, 1.0)));
    }
    let q: Vec<f64> = t.iter().map(|t| (6.0 * t).sin() + 3e-7 * draw.normal()).collect();
    let steady = smooth(&settings, &t, &[&q]).unwrap();
    let exact = smooth(&Settings { steady_state: false, ..settings }, &t, &[&q]).unwrap();
    let most = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(most(&steady.q_rad[0], &exact.q_rad[0]) < 1e-9);
    let off = most(&steady.qdd_rad_s2[0], &exact.qdd_rad_s2[0]) / exact.sd_qdd_rad_s2(0).at(1000);
    assert!(off < 1e-2, "{off} standard deviations");
}

#[test]
fn standard_deviations_are_true() {
    let noise = Noise { process: 50.0, measurement_sd: 1e-4 };
    let settings = Settings::new(MotionModel::ConstantAcceleration, vec![noise]);
    let mut draw = Draw::new(31);
    let steps: Vec<f64> = (0..20_000).map(|_| draw.uniform(0.5e-3, 4e-3)).collect();
    let (t, truth, z) = motion(noise, &steps, 77);
    let s = smooth(&settings, &t, &[&z]).unwrap();
    let lists =
        [(&s.q_rad[0], s.sd_q_rad(0)), (&s.qd_rad_s[0], s.sd_qd_rad_s(0)), (&s.qdd_rad_s2[0], s.sd_qdd_rad_s2(0))];
    for (i, (value, sd)) in lists.into_iter().enumerate() {
        let inside = (0..t.len()).filter(|&k| (value[k] - truth[k][i]).abs() < 1.96 * sd.at(k)).count();
        let share = inside as f64 / t.len() as f64;
        // Errors are correlated over about 10 samples: standard deviation of the share about 0.5 %.
        assert!((0.93..0.97).contains(&share), "derivative {i}: {share}");
    }
    let streamed = stream(&settings, Lag::Samples(3), &t, &[z]);
    let inside = (0..t.len()).filter(|&k| (streamed[k].0[0].qdd - truth[k][2]).abs() < 1.96 * streamed[k].0[0].sd_qdd);
    let share = inside.count() as f64 / t.len() as f64;
    assert!((0.93..0.97).contains(&share), "short lag: {share}");
}

#[test]
fn noise_is_found_from_the_data() {
    let noise = Noise { process: 200.0, measurement_sd: 2e-5 };
    let (t, _, z) = motion(noise, &[1e-3; 6000], 4);
    let model = MotionModel::ConstantAcceleration;
    let both = estimate_noise(model, &t, &z, 1e-3, 1.0, None, 1e-9).unwrap();
    assert!((both.noise.measurement_sd / noise.measurement_sd - 1.0).abs() < 0.05, "{both:?}");
    assert!((both.noise.process / noise.process).ln().abs() < 0.35, "{both:?}");
    assert!(!both.at_limit);
    let known = estimate_noise(model, &t, &z, 1e-3, 1.0, Some(2e-5), 1e-9).unwrap();
    assert!((known.noise.process / noise.process).ln().abs() < 0.35, "{known:?}");
    // No noise around the estimate is likelier.
    for (a, b) in [(1.3, 1.0), (0.7, 1.0), (1.0, 1.1), (1.0, 0.9)] {
        let other = Noise { process: both.noise.process * a, measurement_sd: both.noise.measurement_sd * b };
        assert!(log_likelihood(model, other, 1.0, &t, &z).unwrap() < both.log_likelihood + 0.05);
    }
    assert!(
        (log_likelihood(model, both.noise, 1.0, &t, &z).unwrap() - both.log_likelihood).abs()
            < 1e-6 * both.log_likelihood.abs()
    );
    // A joint at rest shows no motion.
    let mut draw = Draw::new(1);
    let still: Vec<f64> = t.iter().map(|_| 0.5 + 1e-6 * draw.normal()).collect();
    assert!(estimate_noise(model, &t, &still, 1e-3, 1.0, None, 1e-9).unwrap().at_limit);
}

#[test]
fn bandwidth_is_where_the_amplitude_halves() {
    for model in [MotionModel::ConstantAcceleration, MotionModel::ConstantJerk] {
        for hz in [10.0, 40.0] {
            let noise = Noise::from_bandwidth(model, hz, 1e-6, 1e-3);
            assert!((noise.bandwidth_hz(model, 1e-3) / hz - 1.0).abs() < 1e-12);
            let t: Vec<f64> = (0..4000).map(|k| f64::from(k) * 1e-3).collect();
            let q: Vec<f64> = t.iter().map(|t| (std::f64::consts::TAU * hz * t).sin()).collect();
            let s = smooth(&Settings::new(model, vec![noise]), &t, &[&q]).unwrap();
            let gain = s.q_rad[0][2000..3000].iter().zip(&q[2000..3000]).map(|(a, b)| a * b).sum::<f64>()
                / q[2000..3000].iter().map(|v| v * v).sum::<f64>();
            assert!((gain - 0.5).abs() < 0.02, "{model:?} {hz} Hz: {gain}");
        }
    }
}

#[test]
fn gaps_start_anew() {
    let model = MotionModel::ConstantAcceleration;
    let noise = Noise::from_bandwidth(model, 30.0, 1e-5, 1e-2);
    let settings = Settings { gap_s: 0.05, ..Settings::new(model, vec![noise]) };
    let t: Vec<f64> = (0..40)
        .map(|k| f64::from(k) * 0.01 + if k >= 20 { 1.0 } else { 0.0 } + if k >= 38 { 1.0 } else { 0.0 })
        .collect();
    let q: Vec<f64> = t.iter().map(|t| (3.0 * t).sin()).collect();
    let whole = smooth(&settings, &t, &[&q]).unwrap();
    assert_eq!(whole.starts, [0, 20, 38]);
    let part = smooth(&settings, &t[20..38], &[&q[20..38]]).unwrap();
    assert_eq!(whole.qdd_rad_s2[0][20..38], part.qdd_rad_s2[0]);
    // Two samples do not tell an acceleration.
    assert_eq!(whole.q_rad[0][38..], q[38..]);
    assert_eq!(whole.sd_qd_rad_s(0).at(39), PRIOR_SD[0]);
    let streamed = stream(&settings, Lag::Samples(5), &t, &[q]);
    for k in 0..40 {
        let [start, gap, short] = streamed[k].1;
        assert_eq!(start, [0, 20, 38].contains(&k), "{k}");
        assert_eq!(gap, [20, 38].contains(&k), "{k}");
        assert_eq!(short, (15..20).contains(&k) || k >= 33, "{k}");
    }
    assert!(close(streamed[25].0[0].qd, whole.qd_rad_s[0][25], 1e-2));
    assert_eq!(streamed[39].0[0].sd_qdd, PRIOR_SD[1]);
}

#[test]
fn lag_in_seconds_waits_for_time() {
    let model = MotionModel::ConstantAcceleration;
    let settings = Settings::new(model, vec![Noise::from_bandwidth(model, 10.0, 1e-4, 1e-2)]);
    let mut smoother = FixedLag::new(&settings, Lag::Seconds { lag_s: 0.1, most: 64 }).unwrap();
    let mut waited = Vec::new();
    let mut draw = Draw::new(3);
    let mut t = 0.0;
    for _ in 0..300 {
        t += draw.uniform(0.005, 0.02);
        smoother.push(ns(t), &[t.sin()], &mut |e| waited.push((e.newest_ns - e.stamp_ns, e.short)));
    }
    assert!(waited.len() > 250);
    assert!(waited.iter().all(|(w, short)| (100_000_000..120_000_000).contains(w) && !short));
}

#[test]
fn pieces_equal_the_whole() {
    let model = MotionModel::ConstantAcceleration;
    let noise = Noise::from_bandwidth(model, 40.0, 1e-5, 1e-3);
    let settings = Settings { gap_s: 0.1, ..Settings::new(model, vec![noise, noise]) };
    let t: Vec<f64> = (0..20_000).map(|k| f64::from(k) * 1e-3 + if k >= 7000 { 1.0 } else { 0.0 }).collect();
    let mut draw = Draw::new(12);
    let q: Vec<Vec<f64>> =
        (0..2).map(|j| t.iter().map(|t| (5.0 * t + f64::from(j)).sin() + 1e-5 * draw.normal()).collect()).collect();
    let views: Vec<&[f64]> = q.iter().map(Vec::as_slice).collect();
    let whole = smooth(&settings, &t, &views).unwrap();
    let overlap = (20.0 / std::f64::consts::PI / (40.0 * 1e-3)).ceil() as usize;
    let mut next = 0;
    let mut starts = Vec::new();
    smooth_blocks(&settings, &t, &views, 3000, overlap, &mut |first, piece| {
        assert_eq!(first, next);
        next += piece.len();
        starts.extend(piece.starts.iter().map(|s| s + first));
        for j in 0..2 {
            for (k, v) in piece.qdd_rad_s2[j].iter().enumerate() {
                assert!(close(*v, whole.qdd_rad_s2[j][first + k], 1e-7), "sample {}", first + k);
                assert!(close(piece.sd_qdd_rad_s2(j).at(k) / whole.sd_qdd_rad_s2(j).at(first + k), 1.0, 1e-7));
            }
        }
    })
    .unwrap();
    assert_eq!((next, starts), (t.len(), whole.starts));
}

#[test]
fn long_irregular_recordings_compute_blocks_twice_with_the_same_result() {
    // More steps than are kept: the first blocks are kept, the later ones computed again.
    let model = MotionModel::ConstantAcceleration;
    let noise = Noise::from_bandwidth(model, 40.0, 1e-5, 1e-3);
    let settings = Settings::new(model, vec![noise]);
    let mut draw = Draw::new(2);
    let n = 420_000;
    let mut t = vec![0.0];
    for _ in 1..n {
        t.push(t[t.len() - 1] + draw.uniform(0.5e-3, 1.5e-3));
    }
    let q: Vec<f64> = t.iter().map(|t| (5.0 * t).sin()).collect();
    let whole = smooth(&settings, &t, &[&q]).unwrap();
    let tail = smooth(&settings, &t[n - 5000..], &[&q[n - 5000..]]).unwrap();
    for k in 4000..5000 {
        assert!(close(tail.qdd_rad_s2[0][k], whole.qdd_rad_s2[0][n - 5000 + k], 1e-7), "{k}");
    }
}

#[test]
fn update_forms_agree_where_digits_suffice() {
    let noise = Noise { process: 10.0, measurement_sd: 1e-2 };
    let joseph = Settings::new(MotionModel::ConstantAcceleration, vec![noise]);
    let plain = Settings { update: CovarianceUpdate::Subtractive, ..joseph.clone() };
    let (t, _, z) = motion(noise, &[0.05; 400], 6);
    let (a, b) = (smooth(&joseph, &t, &[&z]).unwrap(), smooth(&plain, &t, &[&z]).unwrap());
    for k in 0..t.len() {
        assert!(close(a.qdd_rad_s2[0][k], b.qdd_rad_s2[0][k], 1e-6));
        assert!(close(a.sd_qdd_rad_s2(0).at(k) / b.sd_qdd_rad_s2(0).at(k), 1.0, 1e-6));
    }
}

#[test]
fn bad_input_is_refused_in_words() {
    let noise = Noise { process: 1.0, measurement_sd: 1e-3 };
    let settings = Settings::new(MotionModel::ConstantAcceleration, vec![noise]);
    let words = |r: Result<_, lacuna_estimation::EstimationError>| {
        r.map(|_: lacuna_estimation::kalman::Smoothed| ()).unwrap_err().to_string()
    };
    assert!(words(smooth(&settings, &[0.0, 0.1, 0.1], &[&[0.0; 3]])).contains("sample 2"));
    assert!(words(smooth(&settings, &[0.0, 0.1], &[&[0.0, f64::NAN]])).contains("NaN"));
    assert!(words(smooth(&settings, &[0.0, 0.1], &[&[0.0; 3]])).contains("3"));
    assert!(words(smooth(&settings, &[0.0], &[])).contains("joints"));
    let bad = Settings::new(MotionModel::ConstantAcceleration, vec![Noise { process: f64::NAN, ..noise }]);
    assert!(words(smooth(&bad, &[0.0], &[&[0.0]])).contains("process noise"));
    assert!(smooth(&settings, &[], &[&[]]).unwrap().is_empty());
    assert!(FixedLag::new(&settings, Lag::Samples(1 << 20)).is_err());
    assert!(FixedLag::new(&settings, Lag::Seconds { lag_s: f64::NAN, most: 3 }).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    /// Whatever comes, every sample comes out once, in order, finite.
    #[test]
    fn stream_survives_anything(
        steps in prop::collection::vec((prop_oneof![Just(0i64), Just(1_000_000), Just(-5), 1i64..20, 1i64..3_000_000_000, Just(i64::MAX)], prop_oneof![-1e3..1e3f64, Just(f64::NAN), Just(f64::INFINITY)]), 0..120),
        lag in 0usize..12, jerk in any::<bool>(), joints in 1usize..4,
    ) {
        let model = if jerk { MotionModel::ConstantJerk } else { MotionModel::ConstantAcceleration };
        let mut settings = Settings::new(model, vec![Noise { process: 100.0, measurement_sd: 1e-6 }; joints]);
        settings.gap_s = 2.0;
        let mut smoother = FixedLag::new(&settings, Lag::Samples(lag)).unwrap();
        let mut stamp = 0i64;
        let mut expected = Vec::new();
        let mut found = Vec::new();
        for (step, q) in steps {
            stamp = stamp.saturating_add(step);
            expected.push(stamp);
            smoother.push(stamp, &vec![q; joints], &mut |e| {
                assert_eq!(e.joints.len(), joints);
                assert!(e.joints.iter().all(|j| [j.q, j.qd, j.qdd, j.sd_q, j.sd_qd, j.sd_qdd].iter().all(|v| v.is_finite())), "{e:?}");
                found.push(e.stamp_ns);
            });
        }
        smoother.finish(&mut |e| found.push(e.stamp_ns));
        prop_assert_eq!(found, expected);
    }

    /// Shifting all positions shifts the estimate and nothing else; time has no origin.
    #[test]
    fn estimate_is_equivariant(shift in -100.0..100.0f64, late in 0.0..1e4f64, seed in 0u64..1000) {
        let mut draw = Draw::new(seed);
        let settings = Settings::new(MotionModel::ConstantJerk, vec![Noise { process: 1e4, measurement_sd: 1e-3 }]);
        let mut t = vec![0.0];
        for _ in 0..60 { t.push(t[t.len() - 1] + draw.uniform(0.01, 0.03)); }
        let q: Vec<f64> = t.iter().map(|t| t.sin() + 1e-3 * draw.normal()).collect();
        let moved: Vec<f64> = q.iter().map(|q| q + shift).collect();
        let later: Vec<f64> = t.iter().map(|t| t + late).collect();
        let a = smooth(&settings, &t, &[&q]).unwrap();
        let b = smooth(&settings, &later, &[&moved]).unwrap();
        for k in 0..t.len() {
            prop_assert!((a.q_rad[0][k] + shift - b.q_rad[0][k]).abs() < 1e-8);
            prop_assert!((a.qdd_rad_s2[0][k] - b.qdd_rad_s2[0][k]).abs() < 1e-4);
        }
    }
}

#[test]
fn joints_of_equal_ratio_share_gains_and_keep_their_own_scale() {
    let model = MotionModel::ConstantAcceleration;
    let noise = [1e-5, 7e-6, 3e-4].map(|sd| Noise::from_bandwidth(model, 60.0, sd, 1e-3));
    let settings = Settings::new(model, noise.to_vec());
    let mut draw = Draw::new(21);
    let mut t = vec![0.0];
    (0..300).for_each(|_| t.push(t[t.len() - 1] + 1e-9 * draw.uniform(0.5e6, 2e6).round()));
    let q: Vec<Vec<f64>> =
        noise.iter().map(|n| t.iter().map(|t| (9.0 * t).sin() + n.measurement_sd * draw.normal()).collect()).collect();
    let views: Vec<&[f64]> = q.iter().map(Vec::as_slice).collect();
    let together = smooth(&settings, &t, &views).unwrap();
    let streamed = stream(&settings, Lag::Samples(12), &t, &q);
    for j in 0..3 {
        let alone = Settings::new(model, vec![noise[j]]);
        let whole = smooth(&alone, &t, &[&q[j]]).unwrap();
        let alone = stream(&alone, Lag::Samples(12), &t, std::slice::from_ref(&q[j]));
        for k in 0..t.len() {
            assert!(close(together.qdd_rad_s2[j][k], whole.qdd_rad_s2[0][k], 1e-9));
            assert!(close(together.sd_qdd_rad_s2(j).at(k) / whole.sd_qdd_rad_s2(0).at(k), 1.0, 1e-9));
            let (a, b) = (streamed[k].0[j], alone[k].0[0]);
            assert!(close(a.qdd, b.qdd, 1e-9) && close(a.sd_qd / b.sd_qd, 1.0, 1e-9));
        }
    }
    assert!(together.sd_q_rad(7).at(0).is_nan() && together.sd_q_rad(0).iter().count() == t.len());
}
