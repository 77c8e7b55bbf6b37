//! How long it takes to simulate: `cargo bench -p lacuna-simulate`.
//!
//! One trajectory of 10 s (controller at 4 kHz, four steps a period) on one thread, per robot; then twins per
//! second. Aim: a Delta's 10 s within 1 s.

use lacuna_interfaces::robot::Kind;
use lacuna_interfaces::{ModelFile, RobotFile};
use lacuna_simulate::case::draw_robot;
use lacuna_simulate::config::TrajectoryGroup;
use lacuna_simulate::demo::DEMO_ROBOT;
use lacuna_simulate::random::Random;
use lacuna_simulate::reference::Kinds;
use lacuna_simulate::{SimulationConfig, TrueEffect, Twin, TwinConfig, TwinReference, simulate};
use std::time::Instant;

fn best_of<T>(times: u32, mut work: impl FnMut() -> T) -> f64 {
    let one = |_| {
        let clock = Instant::now();
        std::hint::black_box(work());
        clock.elapsed().as_secs_f64()
    };
    (0..times).map(one).fold(f64::INFINITY, f64::min)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global()?;
    let delta = RobotFile::parse(DEMO_ROBOT)?;
    let mut arm = draw_robot(Kind::Serial, &mut Random::new(1, 0))?;
    for seed in 1.. {
        if arm.joint_count() == 6 {
            break;
        }
        arm = draw_robot(Kind::Serial, &mut Random::new(seed, 0))?;
    }
    let trajectory = TrajectoryGroup { kind: Kinds::Fourier, duration_s: 10.0, count: 1, intensity: 0.9 };
    let soft = TrueEffect::new("elasticity", &["q1"], &[("k", 4000.0)]);
    let rub = TrueEffect::new("load_friction", &[], &[("mu", 0.05)]);
    for (name, robot, effects) in [
        ("Delta", &delta, vec![]),
        ("Delta, elastic joint and load friction", &delta, vec![soft, rub]),
        ("arm of six joints", &arm, vec![]),
    ] {
        let config =
            SimulationConfig { trajectories: vec![trajectory.clone()], effects, ..SimulationConfig::default() };
        simulate(robot, None, &config)?;
        let seconds = best_of(5, || simulate(robot, None, &config));
        println!("{name:40} 10 s in {seconds:.3} s on one thread");
    }
    let config = SimulationConfig { trajectories: vec![trajectory], ..SimulationConfig::default() };
    let source = simulate(&delta, None, &config)?;
    let references: Vec<TwinReference> = source
        .behind
        .iter()
        .map(|l| TwinReference { t_s: l.t_s.clone(), q_rad: l.q_rad.clone(), start_s: 0.0 })
        .collect();
    for rate in [1000.0, 500.0] {
        let twin = Twin::new(&delta, None, &ModelFile::nominal(&delta), TwinConfig::new(vec![0.1; 3], rate))?;
        twin.simulate(&references, &[], 1)?;
        let seconds = best_of(5, || twin.simulate(&references, &[], 1));
        println!("Delta twin at {rate} Hz{:24} 10 s in {seconds:.3} s on one thread", "");
    }
    Ok(())
}
