//! After `new` the stage does not allocate, the look at the first stretch included.

use lacuna_interfaces::{JointMeasured, RobotFile, Stage, StageContext};
use lacuna_smoother::{Config, Smoother};

#[test]
fn step_and_finish() {
    let robot = RobotFile::parse(
        "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
         [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\n",
    )
    .unwrap();
    for config in ["", "process_noise = \"auto\"", "model = \"constant_jerk\"\nlag_samples = 50", "period_s = 0.001"] {
        let config: Config = toml::from_str(config).unwrap();
        let mut stage = Smoother::new(config, &StageContext { robot: &robot, urdf: None, model: None }).unwrap();
        let mut emitted = 0u64;
        let counted = allocation_counter::measure(|| {
            for k in 0..10_000i64 {
                let mut m = JointMeasured::default();
                m.header.seq = k as u64 + 1;
                // Jitter for a while, and a gap.
                let jitter = if (4000..6000).contains(&k) { (k * 7919) % 300_000 } else { 0 };
                m.header.stamp_ns = k * 1_000_000 + jitter + if k > 7000 { 1_000_000_000 } else { 0 };
                for j in 0..3 {
                    m.q_rad[j] = (k as f64 * 5e-3 + j as f64).sin() + 1e-6 * ((k * 31) % 17) as f64;
                }
                stage.step(&m, &mut |_| emitted += 1);
            }
            stage.finish(&mut |_| emitted += 1);
        });
        assert_eq!(counted.count_total, 0, "allocations after new");
        assert_eq!(emitted, 10_000);
    }
}
