use super::*;
use lacuna_interfaces::RepairKind;

const ROBOT: &str =
    "kind = \"serial\"\nname = \"axis\"\njoints = [\"a\"]\n[[dh]]\na = 0.1\n[columns]\nenabled = \"x_on\"\n";

fn robot() -> RobotFile {
    RobotFile::parse(ROBOT).unwrap()
}

const W: f64 = 5.0;

/// q = sin(W t), τ = cos(W t) at the given times.
fn swing(t_s: Vec<f64>) -> Recording {
    Recording {
        name: "swing.csv".to_owned(),
        joints: vec!["a".to_owned()],
        q_rad: vec![t_s.iter().map(|t| (W * t).sin()).collect()],
        tau_nm: vec![t_s.iter().map(|t| (W * t).cos()).collect()],
        t_s,
        ..Recording::default()
    }
}

fn regular(samples: usize) -> Recording {
    swing((0..samples).map(|k| k as f64 * 1e-3).collect())
}

fn plan(recording: &Recording) -> Plan {
    Conditioning { band_hz: Some(20.0), ..Conditioning::default() }.plan(&[recording]).unwrap()
}

/// Largest distance of the stretch's signals from the closed form, ends left out.
fn distance(stretch: &Stretch, torque_lead_s: f64) -> [f64; 4] {
    let mut worst = [0.0f64; 4];
    for k in stretch.cut..stretch.len() - stretch.cut {
        let t = stretch.time_s(k);
        let truth = [(W * t).sin(), W * (W * t).cos(), -W * W * (W * t).sin(), (W * (t + torque_lead_s)).cos()];
        let found = [stretch.q_rad[0][k], stretch.qd_rad_s[0][k], stretch.qdd_rad_s2[0][k], stretch.tau_nm[0][k]];
        for i in 0..4 {
            worst[i] = worst[i].max((truth[i] - found[i]).abs());
        }
    }
    worst
}

#[test]
fn derivatives_are_those_of_the_motion() {
    let recording = regular(4000);
    let out = condition(&recording, &robot(), &plan(&recording)).unwrap();
    assert!(!out.resampled && out.repairs.is_empty() && out.stretches.len() == 1);
    let d = distance(&out.stretches[0], 0.0);
    // What is left of the filter's start after the cut: e^(−2.4 · 40 Hz · 0.1 s) = 7e-5 of 25 rad/s².
    assert!(d[0] < 1e-6 && d[1] < 1e-4 && d[2] < 1e-2 && d[3] < 1e-6, "{d:?}");
    // 1 kHz at a band of 20 Hz: 200 Hz for the columns, 100 Hz for the rows.
    assert_eq!((out.stretches[0].period_s, out.stretches[0].row_step), (5e-3, 2));
}

#[test]
fn irregular_sampling_is_interpolated() {
    let mut t = 0.0;
    let times = (0..6000)
        .map(|k| {
            t += [1.0e-3, 0.7e-3, 1.5e-3, 1.0e-3, 0.9e-3][k % 5];
            t
        })
        .collect();
    let recording = swing(times);
    let out = condition(&recording, &robot(), &plan(&recording)).unwrap();
    assert!(out.resampled && out.sample_rate_hz == 1000.0);
    let d = distance(&out.stretches[0], 0.0);
    assert!(d[0] < 1e-5 && d[1] < 1e-4 && d[2] < 1e-2 && d[3] < 1e-5, "{d:?}");
}

#[test]
fn a_delay_is_undone_and_a_gap_cuts() {
    let mut recording = regular(8000);
    recording.t_s.iter_mut().skip(5000).for_each(|t| *t += 0.8);
    let at = recording.t_s.clone();
    recording = swing(at);
    let mut plan = plan(&recording);
    plan.torque_delay_s = 0.4e-3;
    let out = condition(&recording, &robot(), &plan).unwrap();
    assert_eq!(out.stretches.len(), 2);
    for stretch in &out.stretches {
        let d = distance(stretch, 0.4e-3);
        assert!(d[3] < 1e-5, "{d:?}");
    }
    assert!((out.stretches[1].start_s - 5.8).abs() < 1e-9);
}

#[test]
fn repairs_are_made_and_counted() {
    let mut recording = regular(4000);
    recording.tau_nm[0][1000] += 5.0;
    recording.q_rad[0][2500] -= 0.5;
    recording.q_rad[0].iter_mut().skip(3000).for_each(|q| *q += std::f64::consts::TAU);
    let out = condition(&recording, &robot(), &plan(&recording)).unwrap();
    let counted: Vec<(RepairKind, &str, u64)> =
        out.repairs.iter().map(|r| (r.kind, r.signal.as_str(), r.count)).collect();
    let expected = [(RepairKind::Unwrapped, "q1", 1), (RepairKind::Spike, "q1", 1), (RepairKind::Spike, "tau1", 1)];
    assert_eq!(counted, expected);
    let d = distance(&out.stretches[0], 0.0);
    assert!(d[0] < 1e-5 && d[2] < 1e-2 && d[3] < 1e-5, "{d:?}");
}

#[test]
fn masks_leave_out_what_says_nothing() {
    let mut recording = regular(6000);
    recording.extra.insert("x_on".to_owned(), (0..6000).map(|k| f64::from(u8::from(k < 4000))).collect());
    let plan = Plan { moving_rad_s: 1.0, reversal_s: 0.02, ..plan(&recording) };
    let out = condition(&recording, &robot(), &plan).unwrap();
    let s = &out.stretches[0];
    for k in 0..s.len() {
        let (t, speed) = (s.time_s(k), s.qd_rad_s[0][k].abs());
        assert_eq!(s.usable[k], t < 3.9995, "{t}");
        assert_eq!(s.counted[0][k], s.usable[k] && speed > 1.0);
        // 20 ms before and after: cos(W t) then still changes by up to 0.1 of 5 rad/s times W.
        if s.fitted[0][k] {
            assert!(s.counted[0][k] && speed > 1.0 && t < 3.981, "{t} {speed}");
        }
    }
    let share = |mask: &[bool]| mask.iter().filter(|m| **m).count();
    assert!(share(&s.fitted[0]) > s.len() / 3 && share(&s.fitted[0]) < share(&s.counted[0]));
}

#[test]
fn bad_settings_and_recordings_are_refused_in_words() {
    let recording = regular(4000);
    let settings = |f: &dyn Fn(&mut Conditioning)| {
        let mut c = Conditioning::default();
        f(&mut c);
        c.plan(&[&recording]).unwrap_err().to_string()
    };
    for (found, expected) in [
        (settings(&|c| c.band_hz = Some(450.0)), "at most 400"),
        (settings(&|c| c.band_hz = Some(f64::NAN)), "positive"),
        (settings(&|c| c.moving_rad_s = -1.0), "moving_rad_s"),
        (settings(&|c| c.position_band_hz = Some(1.0)), "at least the band"),
    ] {
        assert!(found.contains(expected) && !found.contains('\n'), "{found}");
    }
    assert!(Conditioning::default().plan(&[]).is_err());
    let short = regular(30);
    let e = condition(&short, &robot(), &plan(&recording)).unwrap_err().to_string();
    assert!(e.starts_with("swing.csv: ") && e.contains("at least"), "{e}");
    let mut ragged = regular(100);
    ragged.tau_nm[0].pop();
    assert!(condition(&ragged, &robot(), &plan(&recording)).unwrap_err().to_string().contains("99 tau samples"));
    let mut other = regular(100);
    other.joints[0] = "b".to_owned();
    assert!(condition(&other, &robot(), &plan(&recording)).unwrap_err().to_string().contains("joints b"));
    let mut broken = regular(4000);
    broken.q_rad[0][7..40].fill(f64::NAN);
    assert!(condition(&broken, &robot(), &plan(&recording)).is_err());
}
