//! Twins follow the motion they are given, with the noise they are given, and show an effect when they have one.

use lacuna_interfaces::model::Term;
use lacuna_interfaces::{ModelFile, RobotFile};
use lacuna_simulate::config::TrajectoryGroup;
use lacuna_simulate::demo::DEMO_ROBOT;
use lacuna_simulate::reference::Kinds;
use lacuna_simulate::{SimulationConfig, TrueEffect, Twin, TwinConfig, TwinReference, simulate};

fn robot() -> RobotFile {
    RobotFile::parse(DEMO_ROBOT).unwrap()
}

fn fitted() -> ModelFile {
    let mut model = ModelFile::nominal(&robot());
    model.friction.f_c = vec![2.0, 2.2, 1.8];
    model.friction.f_v = vec![0.5, 0.6, 0.4];
    model.friction.offset = vec![0.3, 0.0, -0.2];
    model.rigid_body.parameters.insert("I1".to_owned(), 0.2);
    model.terms.push(Term {
        effect: "stribeck".to_owned(),
        joints: vec!["q3".to_owned()],
        parameters: [("f_sc".to_owned(), 1.0), ("v_s".to_owned(), 0.2)].into(),
    });
    model
}

fn references() -> Vec<TwinReference> {
    let group = |kind| TrajectoryGroup { kind, duration_s: 3.0, count: 1, intensity: 0.8 };
    let config = SimulationConfig {
        trajectories: vec![group(Kinds::Fourier), group(Kinds::PointToPoint)],
        ..SimulationConfig::default()
    };
    let s = simulate(&robot(), None, &config).unwrap();
    s.behind.iter().map(|l| TwinReference { t_s: l.t_s.clone(), q_rad: l.q_rad.clone(), start_s: 2.0 }).collect()
}

#[test]
fn a_twin_follows_its_reference_and_carries_its_model() {
    let references = references();
    let quiet = |model: &ModelFile| {
        let config = TwinConfig { encoder_steps: 0.0, ..TwinConfig::new(vec![0.0; 3], 1000.0) };
        Twin::new(&robot(), None, model, config).unwrap().simulate(&references, &[], 1).unwrap()
    };
    let (with, without) = (quiet(&fitted()), quiet(&ModelFile::nominal(&robot())));
    for (r, reference) in with.iter().zip(&references) {
        assert!((r.duration_s() - 3.0).abs() < 5e-3);
        for i in 0..3 {
            let off = r.q_rad[i].iter().zip(&reference.q_rad[i]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 0.02, "joint {} is {off} rad off its reference", i + 1);
        }
    }
    // What friction and offset add to joint 2, which has no other change: ± f_c and f_v θ̇.
    for (a, b) in with.iter().zip(&without) {
        let speed = |k: usize| (a.q_rad[1][k + 5] - a.q_rad[1][k - 5]) / 10e-3;
        let (mut n, mut error) = (0.0, 0.0);
        for k in 20..a.len() - 20 {
            if speed(k - 10) * speed(k + 10) > 0.0 && speed(k).abs() > 0.3 {
                let added = 2.2 * speed(k).signum() + 0.6 * speed(k);
                error += (a.tau_nm[1][k] - b.tau_nm[1][k] - added).powi(2);
                n += 1.0;
            }
        }
        assert!(n > 300.0 && f64::sqrt(error / n) < 0.6, "{} over {n}", f64::sqrt(error / n));
    }
}

#[test]
fn many_twins_are_the_same_in_any_company_and_effects_show() {
    let references = references();
    let twin = Twin::new(&robot(), None, &fitted(), TwinConfig::new(vec![0.1; 3], 500.0)).unwrap();
    let extra = TrueEffect::new("torque_offset", &["q2"], &[("tau_0", 2.0)]);
    let cases: Vec<(Vec<TrueEffect>, u64)> =
        vec![(Vec::new(), 1), (vec![extra.clone()], 1), (Vec::new(), 2), (Vec::new(), 1)];
    let many: Vec<_> = twin.simulate_many(&references, &cases).into_iter().map(Result::unwrap).collect();
    assert_eq!(many[0], many[3]);
    assert_eq!(many[1], twin.simulate(&references, &[extra], 1).unwrap());
    assert_ne!(many[0], many[2], "another seed, other noise");
    let mean = |k: usize| {
        let all: Vec<f64> = many[k].iter().flat_map(|r| r.tau_nm[1].iter().copied()).collect();
        all.iter().sum::<f64>() / all.len() as f64
    };
    assert!((mean(1) - mean(0) - 2.0).abs() < 0.3, "{}", mean(1) - mean(0));
    assert!((many[0][0].median_period_s().unwrap() - 2e-3).abs() < 1e-9);
}

#[test]
fn models_that_cannot_be_simulated_are_refused_in_words() {
    let config = || TwinConfig::new(vec![0.1; 3], 1000.0);
    let build = |change: &dyn Fn(&mut ModelFile), config: TwinConfig| {
        let mut model = fitted();
        change(&mut model);
        Twin::new(&robot(), None, &model, config).unwrap_err().to_string()
    };
    let parameter = |symbol: &'static str, value: f64| {
        move |m: &mut ModelFile| {
            m.rigid_body.parameters.insert(symbol.to_owned(), value);
        }
    };
    assert!(build(&parameter("I4", 1.0), config()).contains("I4"));
    assert!(build(&parameter("Ixx1", 1.0), config()).contains("Ixx1"));
    assert!(build(&parameter("I2", -50.0), config()).contains("joint 2: found an inertia of -"));
    assert!(build(&|_| {}, TwinConfig::new(vec![0.1; 2], 1000.0)).contains("2 torque noises"));
    let mut model = fitted();
    model.terms[0].effect = "magic".to_owned();
    let twin = Twin::new(&robot(), None, &model, config()).unwrap();
    assert!(twin.simulate(&references(), &[], 1).unwrap_err().to_string().contains("magic"));
    let short = TwinReference { t_s: vec![0.0], q_rad: vec![vec![0.0]; 3], start_s: 0.0 };
    let twin = Twin::new(&robot(), None, &fitted(), config()).unwrap();
    assert!(twin.simulate(&[short], &[], 1).unwrap_err().to_string().contains("at least 2"));
    let backwards = TwinReference { t_s: vec![0.0, 0.2, 0.1], q_rad: vec![vec![0.0; 3]; 3], start_s: 0.0 };
    assert!(twin.simulate(&[backwards], &[], 1).unwrap_err().to_string().contains("rise"));
}
