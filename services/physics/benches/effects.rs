//! Nanoseconds per sample of every effect on the stream, one thread: `cargo bench -p lacuna-physics --bench effects`.
//!
//! Each row is one term on a Delta and, where it exists there, on a six-joint arm; median of several rounds.

#[path = "../tests/common/mod.rs"]
mod common;
#[path = "../tests/common/effects.rs"]
mod support;

use lacuna_interfaces::{Joints, MAX_JOINTS};
use lacuna_physics::Motion;
use lacuna_physics::effects::{Effect, EffectSample, registry};
use std::hint::black_box;
use std::time::Instant;
use support::{Robot, fits, joints, shaking, typical, with_drive};

const SAMPLES: usize = 2000;
const ROUNDS: usize = 21;

/// q, q̇, q̈, direction, torque.
type Row = [Joints; 5];

fn rows(robot: &Robot) -> Vec<Row> {
    let n = robot.n();
    (0..SAMPLES)
        .map(|k| {
            let at = |i: usize| -> Joints {
                std::array::from_fn(|j| if j < n { shaking(j, k as f64 * 1e-3)[i] } else { 0.0 })
            };
            let (q, qd, qdd) = (at(0), at(1), at(2));
            let mut tau = [0.0; MAX_JOINTS];
            let motion = Motion { q_rad: &q[..n], qd_rad_s: &qd[..n], qdd_rad_s2: &qdd[..n] };
            robot.body.torque(&motion, &robot.pi, &mut tau[..n]).expect("a reachable motion");
            [q, qd, qdd, qd.map(f64::signum), tau]
        })
        .collect()
}

fn time(effect: &'static Effect, robot: &Robot, rows: &[Row]) -> f64 {
    let at = joints(effect, robot.n());
    let mut term = effect.term(&at, &typical(effect, &robot.file), &robot.context()).expect("typical parameters");
    let temperature = [30.0; MAX_JOINTS];
    let mut rounds: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            term.reset();
            let start = Instant::now();
            for (k, [q, qd, qdd, direction, tau]) in rows.iter().enumerate() {
                let sample = EffectSample {
                    t_s: k as f64 * 1e-3,
                    dt_s: 1e-3,
                    q_rad: q,
                    qd_rad_s: qd,
                    qdd_rad_s2: qdd,
                    direction,
                    ramp_rad_s: 0.01,
                    tau_link_nm: tau,
                    tau_drive_nm: tau,
                    temperature_degc: &temperature,
                };
                let mut out = [0.0; MAX_JOINTS];
                term.add_torque(black_box(&sample), &mut out);
                black_box(out);
            }
            start.elapsed().as_secs_f64() * 1e9 / rows.len() as f64
        })
        .collect();
    rounds.sort_by(f64::total_cmp);
    rounds[ROUNDS / 2]
}

fn main() {
    let robots = [common::DELTA, common::ARM].map(|text| Robot::new(&with_drive(text)));
    let rows = [rows(&robots[0]), rows(&robots[1])];
    println!("{:<20} {:>12} {:>12}   ns per sample", "effect", "Delta", "six joints");
    for effect in registry() {
        let cell = |i: usize| {
            let robot: &Robot = &robots[i];
            if fits(effect, &robot.file) { format!("{:.0}", time(effect, robot, &rows[i])) } else { "-".to_owned() }
        };
        println!("{:<20} {:>12} {:>12}", effect.id, cell(0), cell(1));
    }
}
