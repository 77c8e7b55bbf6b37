//! The stream does not allocate, whatever comes.

use lacuna_estimation::kalman::{FixedLag, Lag, MotionModel, Noise, Settings, estimate_noise};

#[test]
fn fixed_lag_smoother_and_noise_estimate() {
    for model in [MotionModel::ConstantAcceleration, MotionModel::ConstantJerk] {
        let noise = Noise::from_bandwidth(model, 60.0, 1e-5, 1e-3);
        let other = Noise { process: noise.process * 2.0, ..noise };
        let settings = Settings { gap_s: 0.05, ..Settings::new(model, vec![noise, other, noise]) };
        let finer = Settings { noise: vec![other, noise, Noise { process: 1.0, ..noise }], ..settings.clone() };
        let mut stream = FixedLag::new(&settings, Lag::Samples(25)).unwrap();
        let (mut stamp, mut sum, mut emitted) = (0i64, 0.0, 0usize);
        let counted = allocation_counter::measure(|| {
            for k in 0..20_000i64 {
                // Regular, jittered and regular again, with gaps; then other noise.
                stamp += match k {
                    5000..10_000 => 800_000 + (k * 7919) % 400_000,
                    _ if k % 3000 == 2999 => 1_000_000_000,
                    _ => 1_000_000,
                };
                let q = (stamp as f64 * 6e-9).sin();
                let mut emit = |e: &lacuna_estimation::kalman::LagEstimate<'_>| {
                    sum += e.joints[2].qdd;
                    emitted += 1;
                };
                if k == 15_000 {
                    stream.set(&finer, Lag::Samples(20), &mut emit).unwrap();
                }
                stream.push(stamp, &[q, 0.5 * q, -q], &mut emit);
            }
            stream.finish(&mut |_| emitted += 1);
        });
        assert_eq!(counted.count_total, 0, "allocations on the stream");
        assert_eq!(emitted, 20_000);
        assert!(sum.is_finite());

        let t: Vec<f64> = (0..500).map(|k| f64::from(k) * 1e-3).collect();
        let q: Vec<f64> = t.iter().enumerate().map(|(k, t)| t.sin() + 1e-6 * ((k * 7919) % 101) as f64).collect();
        let mut found = false;
        let counted =
            allocation_counter::measure(|| found = estimate_noise(model, &t, &q, 1e-3, 0.1, None, 1e-9).is_ok());
        assert_eq!(counted.count_total, 0, "allocations of the noise estimate");
        assert!(found);
    }
}
