//! The monitor on made residuals: its false alarm rate, what it must see, where, and what must not disturb it.

use lacuna_interfaces::{
    BadInput, ModelFile, PayloadEstimate, ResidualWatch, RobotFile, Stage, StageContext, flag, region,
};
use lacuna_monitor::{Config, Monitor};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const DELTA: &str = "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
    [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\n";
const SD_NM: f64 = 0.1;

fn robot() -> RobotFile {
    RobotFile::parse(DELTA).unwrap()
}

fn make(config: &str, sd: &[f64]) -> Result<Monitor, BadInput> {
    let config: Config = toml::from_str(config).map_err(|e| BadInput::from_toml(&e, config))?;
    let robot = robot();
    let mut model = ModelFile::nominal(&robot);
    model.noise.sd_tau_nm = sd.to_vec();
    Monitor::new(config, &StageContext { robot: &robot, urdf: None, model: Some(&model) })
}

fn monitor(config: &str) -> Monitor {
    make(config, &[SD_NM; 3]).unwrap()
}

/// A standard normal number (Box and Muller: true tails, since the threshold lives there).
fn normal(rng: &mut Pcg64Mcg) -> f64 {
    let (u, v): (f64, f64) = (rng.random_range(1e-300..1.0), rng.random_range(0.0..1.0));
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// Joints that swing, with residuals of correlated noise and whatever is added.
struct Motion {
    period_s: f64,
    /// Time constant of the noise [s]; 0: white.
    tau_s: f64,
    noise_nm: f64,
    rng: Pcg64Mcg,
    state: [f64; 3],
    k: i64,
}

impl Motion {
    fn new(period_s: f64, tau_s: f64, seed: u64) -> Self {
        Self { period_s, tau_s, noise_nm: SD_NM, rng: Pcg64Mcg::seed_from_u64(seed), state: [0.0; 3], k: 0 }
    }

    fn next(&mut self, extra: impl Fn(f64, usize, f64, f64, f64) -> f64) -> PayloadEstimate {
        let t = self.k as f64 * self.period_s;
        let mut m = PayloadEstimate::default();
        m.header.seq = self.k as u64 + 1;
        m.header.stamp_ns = (t * 1e9).round() as i64;
        m.header.joints = 3;
        m.header.flags = if self.k == 0 { flag::STATE_RESET } else { 0 };
        let r = if self.tau_s > 0.0 { (-self.period_s / self.tau_s).exp() } else { 0.0 };
        for i in 0..3 {
            let phase = 3.0 * t + 2.1 * i as f64;
            (m.q_rad[i], m.qd_rad_s[i]) = (0.5 * phase.sin(), 1.5 * phase.cos());
            m.tau_model_nm[i] = 4.0 * (2.3 * t + i as f64).sin();
            self.state[i] = r * self.state[i] + (1.0 - r * r).sqrt() * self.noise_nm * normal(&mut self.rng);
            m.residual_nm[i] = self.state[i] + extra(t, i, m.q_rad[i], m.qd_rad_s[i], m.tau_model_nm[i]);
        }
        self.k += 1;
        m
    }
}

/// Runs for `seconds`; returns the last message, and the alarms that began as (joint, time).
fn run(
    stage: &mut Monitor,
    motion: &mut Motion,
    seconds: f64,
    extra: impl Fn(f64, usize, f64, f64, f64) -> f64 + Copy,
) -> (ResidualWatch, Vec<(usize, f64)>) {
    let mut last = ResidualWatch::default();
    let mut alarms = Vec::new();
    let until = motion.k + (seconds / motion.period_s) as i64;
    while motion.k < until {
        let sample = motion.next(extra);
        stage.step(&sample, &mut |o| {
            let new = o.alarm & !last.alarm;
            alarms.extend((0..3).filter(|i| new >> i & 1 == 1).map(|i| (i, o.header.stamp_ns as f64 * 1e-9)));
            last = *o;
        });
    }
    (last, alarms)
}

#[test]
fn false_alarms_keep_to_the_configured_rate() {
    // White, correlated within a block, and correlated over several blocks.
    for (tau_s, seed) in [(0.0, 1), (0.03, 2), (0.3, 3)] {
        let (hours, rate) = (30.0, 4.0);
        let mut stage = monitor("false_alarms_per_hour = 4.0");
        let mut motion = Motion::new(0.01, tau_s, seed);
        let (_, alarms) = run(&mut stage, &mut motion, 3600.0 * hours, |_, _, _, _, _| 0.0);
        let (found, allowed) = (alarms.len() as f64, hours * rate);
        eprintln!("noise over {tau_s} s: {found} false alarms in {hours} h; at most {allowed} are configured");
        // 97.5 % point of a Poisson count.
        assert!(found <= allowed + 1.96 * allowed.sqrt(), "{found} false alarms, {allowed} allowed");
        // A monitor that never speaks would pass that: its rate is to be of the order it was asked for.
        assert!(found >= 0.03 * allowed, "{found} false alarms, {allowed} allowed");
    }
}

#[test]
fn a_mismatch_raises_its_own_joint_soon_and_is_told_where() {
    type Extra = fn(f64, usize, f64, f64, f64) -> f64;
    type Region = Option<(u32, f64, f64)>;
    let cases: [(&str, Extra, f64, Region); 5] = [
        (
            "friction rises",
            |t, i, _, qd, _| if i == 1 && t > 60.0 { 0.3 * qd.signum() } else { 0.0 },
            0.6,
            Some((region::VELOCITY, -1.6, 1.6)),
        ),
        (
            "a rough place",
            |t, i, q, _, _| if i == 1 && t > 60.0 && q > 0.25 { 0.5 } else { 0.0 },
            3.0,
            Some((region::POSITION, 0.1, 0.6)),
        ),
        (
            "drive's constant is off",
            |t, i, _, _, load| if i == 1 && t > 60.0 { 0.1 * load } else { 0.0 },
            3.0,
            Some((region::LOAD, -6.5, 6.5)),
        ),
        ("an offset", |t, i, _, _, _| if i == 1 && t > 60.0 { 0.3 } else { 0.0 }, 0.6, Some((region::TIME, 0.0, 0.0))),
        ("a collision", |t, i, _, _, _| if i == 1 && (60.2..60.4).contains(&t) { 1.0 } else { 0.0 }, 0.6, None),
    ];
    for (what, extra, delay_s, place) in cases {
        let mut stage = monitor("");
        let mut motion = Motion::new(0.001, 0.01, 7);
        let (_, before) = run(&mut stage, &mut motion, 60.0, extra);
        assert!(before.is_empty(), "{what}: {before:?}");
        let (first, alarms) = run(&mut stage, &mut motion, delay_s, extra);
        assert!(!alarms.is_empty() && alarms.iter().all(|a| a.0 == 1), "{what}: {alarms:?}, score {:?}", first.score);
        let since_s = first.since_ns[1] as f64 * 1e-9;
        // The evidence may happen to be on its way up from noise when the mismatch begins.
        assert!((57.0..60.0 + delay_s).contains(&since_s), "{what}: onset at {since_s}");
        assert!(first.header.has(flag::MISMATCH));
        let Some((variable, low, high)) = place else {
            // It passed: the alarm ends by itself and does not come back.
            let (ended, _) = run(&mut stage, &mut motion, 15.0, extra);
            let (_, again) = run(&mut stage, &mut motion, 15.0, extra);
            assert!(ended.alarm == 0 && again.is_empty(), "{what}: {again:?}");
            continue;
        };
        let (last, _) = run(&mut stage, &mut motion, 4.0, extra);
        let found = (last.region_variable[1], last.region_low[1], last.region_high[1]);
        eprintln!("{what}: {:.2} s after 60 s, region {found:?}", alarms[0].1 - 60.0);
        assert_eq!(found.0, variable, "{what}: {found:?}");
        if variable != region::TIME {
            assert!(found.1 >= low && found.2 <= high, "{what}: {found:?}; expected within {low} to {high}");
        }
    }
}

#[test]
fn standing_reversing_and_unusable_samples_are_not_judged() {
    let alarms = |edit: fn(&mut PayloadEstimate)| {
        let mut stage = monitor("");
        let mut motion = Motion::new(0.001, 0.0, 9);
        let mut count = 0;
        for _ in 0..20_000 {
            let mut m = motion.next(|_, _, _, _, _| 0.0);
            edit(&mut m);
            stage.step(&m, &mut |o| count += o.alarm.count_ones());
        }
        count
    };
    assert_eq!(alarms(|_| ()), 0);
    assert!(alarms(|m| m.residual_nm = [1.0; 8]) > 0, "the tests below would show nothing otherwise");
    for edit in [
        (|m| (m.qd_rad_s, m.residual_nm) = ([0.01; 8], [5.0; 8])) as fn(&mut PayloadEstimate),
        |m| m.residual_nm = m.qd_rad_s.map(|v| if v.abs() < 0.06 { 5.0 } else { 0.0 }),
        |m| (m.header.flags, m.residual_nm) = (flag::DRIVE_OFF, [5.0; 8]),
        |m| (m.header.flags, m.residual_nm) = (flag::UNREACHABLE, [5.0; 8]),
        |m| m.residual_nm = [f64::NAN; 8],
        |m| m.qd_rad_s = [f64::NAN; 8],
    ] {
        assert_eq!(alarms(edit), 0);
    }
}

#[test]
fn the_residual_after_the_payload_is_watched_on_request() {
    for (config, expected) in [("", true), ("residual = \"payload\"", false)] {
        let mut stage = monitor(config);
        let mut motion = Motion::new(0.001, 0.0, 5);
        let mut alarmed = false;
        for _ in 0..5_000 {
            let mut m = motion.next(|_, _, _, _, _| 0.0);
            m.residual_payload_nm = m.residual_nm;
            m.residual_nm = [2.0; 8];
            stage.step(&m, &mut |o| alarmed |= o.alarm != 0);
        }
        assert_eq!(alarmed, expected, "{config}");
    }
}

#[test]
fn a_joint_without_known_noise_is_not_watched() {
    for (sd, watched) in [(vec![], 0), (vec![0.1, 0.0, 0.1], 0b101)] {
        let mut stage = make("", &sd).unwrap();
        let mut motion = Motion::new(0.001, 0.0, 5);
        let (last, alarms) = run(&mut stage, &mut motion, 5.0, |_, i, _, _, _| if i == 1 { 50.0 } else { 0.0 });
        assert_eq!(last.watched, watched);
        assert!(alarms.is_empty());
    }
}

#[test]
fn what_was_learnt_outlasts_a_gap_and_evidence_does_not() {
    let mut stage = monitor("");
    let mut motion = Motion::new(0.001, 0.0, 5);
    let (quiet, _) = run(&mut stage, &mut motion, 60.0, |_, _, _, _, _| 0.0);
    assert!(quiet.sd_nm[0] < 0.5 * SD_NM, "learnt: {}", quiet.sd_nm[0]);
    let (loud, _) = run(&mut stage, &mut motion, 2.0, |_, _, _, _, _| 1.0);
    assert_eq!(loud.alarm, 0b111);
    let mut m = motion.next(|_, _, _, _, _| 0.0);
    m.header.flags |= flag::GAP;
    stage.step(&m, &mut |o| {
        assert_eq!(o.alarm, 0);
        assert!(o.score[..3].iter().all(|s| *s == 0.0));
    });
    let (after, alarms) = run(&mut stage, &mut motion, 2.0, |_, _, _, _, _| 0.0);
    assert!(alarms.is_empty() && after.sd_nm[0] < 0.5 * SD_NM);
}

#[test]
fn two_runs_give_the_same_bytes() {
    let all = || {
        let mut stage = monitor("");
        let mut motion = Motion::new(0.001, 0.05, 11);
        let mut out = Vec::new();
        for _ in 0..20_000 {
            let m = motion.next(|t, i, _, qd, _| if i == 0 && t > 10.0 { 0.4 * qd } else { 0.0 });
            stage.step(&m, &mut |o| out.push(*o));
        }
        out
    };
    assert_eq!(all(), all());
}

#[test]
fn configurations_without_sense_are_refused_in_words() {
    for (config, expected) in [
        ("false_alarms_per_hour = 0.0", "false_alarms_per_hour"),
        ("false_alarms_per_hour = nan", "false_alarms_per_hour"),
        ("false_alarms_per_hour = 1e9", "at most 3600"),
        ("block_s = -1.0", "block_s"),
        ("growth = 1.0", "growth"),
        ("growth = nan", "growth"),
        ("learn_s = 0.5", "ten times block_s"),
        ("reversal_s = -0.1", "reversal_s"),
        ("model_error = inf", "model_error"),
        ("residual = \"all\"", "unknown variant"),
        ("speed = 1", "unknown field"),
    ] {
        let e = make(config, &[0.1; 3]).expect_err(config).to_string();
        assert!(e.contains(expected) && !e.contains('\n'), "{config}: {e}");
    }
}

proptest! {
    #[test]
    fn every_input_gives_one_output_and_no_number_breaks_it(
        rows in prop::collection::vec((any::<f64>(), any::<f64>(), any::<f64>(), any::<f64>(), any::<i64>(), any::<u32>()), 1..200)
    ) {
        let mut stage = monitor("");
        for (k, (q, qd, tau, e, stamp, flags)) in rows.into_iter().enumerate() {
            let mut m = PayloadEstimate {
                q_rad: [q; 8], qd_rad_s: [qd; 8], tau_model_nm: [tau; 8], residual_nm: [e; 8], ..PayloadEstimate::default()
            };
            m.header.seq = k as u64 + 1;
            m.header.stamp_ns = stamp;
            m.header.flags = flags & !flag::END_OF_STREAM;
            let mut seen = 0;
            stage.step(&m, &mut |o| {
                seen += 1;
                assert_eq!(o.header.seq, m.header.seq);
                assert_eq!(o.alarm & !o.watched, 0);
                assert!(o.score.iter().all(|s| s.is_finite() && *s >= 0.0));
                assert!((0..8).all(|i| o.region_low[i] <= o.region_high[i]));
            });
            prop_assert_eq!(seen, 1);
        }
    }

    #[test]
    fn the_unit_of_torque_does_not_matter(scale in 1e-3f64..1e3, seed in 0u64..1000) {
        // Residual, noise and load in another unit: the same evidence.
        let run = |scale: f64| {
            let mut stage = make("", &[SD_NM * scale; 3]).unwrap();
            let mut motion = Motion::new(0.01, 0.05, seed);
            let mut score = [0.0; 8];
            for _ in 0..2000 {
                let mut m = motion.next(|t, _, _, qd, _| if t > 15.0 { 0.05 * qd } else { 0.0 });
                m.residual_nm = m.residual_nm.map(|v| v * scale);
                m.tau_model_nm = m.tau_model_nm.map(|v| v * scale);
                stage.step(&m, &mut |o| score = o.score);
            }
            score
        };
        for (a, b) in run(1.0).into_iter().zip(run(scale)) {
            prop_assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
    }
}
