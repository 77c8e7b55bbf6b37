//! Recordings of a Delta with concealed physics, through smoother, torque and friction stage.

mod common;

use lacuna_estimation::filter::ZeroPhase;
use lacuna_estimation::stats::rms;
use lacuna_interfaces::{PayloadEstimate, Stage, StageContext, flag};
use lacuna_payload::{Config, Payload};

fn run(case: &common::Case, recording: &common::Recording) -> Vec<PayloadEstimate> {
    let context = StageContext { robot: &case.robot, urdf: None, model: Some(&case.model) };
    let mut stage = Payload::new(Config::default(), &context).unwrap();
    let mut out = Vec::new();
    recording.samples.iter().for_each(|m| stage.step(m, &mut |o| out.push(*o)));
    out
}

/// Within 0.3 s of every pick the mass is within 3 %, within 0.3 s of every place it is zero to 3 % of it. Picks
/// happen in dwells too: the time counts from when a joint slides again, and until then the mass is unknown.
#[test]
fn payload_of_case_09113() {
    let Some(case) = common::load("case_09113", "") else { return };
    for recording in &case.recordings {
        let out = run(&case, recording);
        let mut settled = 0;
        // Time in motion since the load last changed.
        let (mut moving_s, mut before) = (0.0, 0.0);
        for (o, m) in out.iter().zip(&recording.samples) {
            let t = o.header.stamp_ns as f64 * 1e-9;
            let truth = recording.loads.iter().find(|l| (l.0..l.1).contains(&t)).map_or(0.0, |l| l.2);
            moving_s = if truth == before { moving_s + if m.standstill == 0 { 1e-3 } else { 0.0 } } else { 0.0 };
            before = truth;
            let known = o.header.flags & flag::NOT_EXCITED == 0;
            if known && moving_s > 0.3 {
                settled += 1;
                let full = recording.loads.first().map_or(1.15, |l| l.2);
                assert!((o.mass_kg - truth).abs() < 0.03 * full, "{} at {t:.3} s: {} kg", recording.file, o.mass_kg);
                assert!((o.mass_kg - truth).abs() < 6.0 * o.sd_mass_kg + 0.01 * truth, "interval at {t:.3} s");
            }
            // Soon after a change it is either right or said to be unknown.
            if known && moving_s > 0.05 {
                assert!((o.mass_kg - truth).abs() < 0.1, "{} at {t:.3} s: {} kg", recording.file, o.mass_kg);
            }
        }
        assert!(settled > 1000, "{}: {settled} samples", recording.file);
        let steps = out.iter().filter(|o| o.header.flags & flag::PAYLOAD_STEP != 0).count();
        assert_eq!(steps, 2 * recording.loads.len(), "{}", recording.file);
    }
}

/// Recordings without payload: none is seen, and with the true friction the moving residual in the 40 Hz band
/// is the oracle's, which shows that smoother and torque add nothing.
#[test]
fn clean_cases_reach_the_oracle() {
    for name in ["case_09000", "case_09001", "case_09002"] {
        let Some(case) = common::load(name, "") else { return };
        let filter = ZeroPhase::butterworth(4, 40.0, 1000.0).unwrap();
        let mut moving: Vec<Vec<f64>> = vec![Vec::new(); 3];
        for recording in &case.recordings {
            let out = run(&case, recording);
            assert!(out.iter().all(|o| o.header.flags & flag::PAYLOAD_STEP == 0), "{name} {}", recording.file);
            let known = out.iter().filter(|o| o.header.flags & flag::NOT_EXCITED == 0);
            assert!(known.clone().all(|o| o.mass_kg.abs() < 0.15), "{name} {}", recording.file);
            assert!(known.count() > 2000);
            for (j, moving) in moving.iter_mut().enumerate() {
                let residual: Vec<f64> = out.iter().map(|o| o.residual_nm[j]).collect();
                let y = filter.apply(&residual).unwrap();
                // The filter spreads what happens at reversals over 25 ms.
                for k in 50..y.len() - 50 {
                    if out[k - 25..k + 25].iter().all(|o| o.qd_rad_s[j].abs() > 0.05) {
                        moving.push(y[k]);
                    }
                }
            }
        }
        for (j, moving) in moving.iter().enumerate() {
            let oracle = case.key["oracle"]["from_csv_rms_40Hz"][j].as_f64().unwrap();
            let ratio = rms(moving) / oracle;
            assert!(ratio < 1.2, "{name} joint {}: {ratio:.2} times the oracle", j + 1);
        }
    }
}
