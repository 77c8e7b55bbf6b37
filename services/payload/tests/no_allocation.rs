//! After `new` the stage does not allocate.

use lacuna_interfaces::{FrictionTorque, RobotFile, Stage, StageContext};
use lacuna_payload::{Config, Payload};

#[test]
fn step_and_finish() {
    let robot = RobotFile::parse(
        "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
         [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\n",
    )
    .unwrap();
    let mut stage = Payload::new(Config::default(), &StageContext { robot: &robot, urdf: None, model: None }).unwrap();
    let (mut emitted, mut mass) = (0, 0.0);
    let counted = allocation_counter::measure(|| {
        for k in 0..10_000i64 {
            let mut m = FrictionTorque::default();
            m.header.stamp_ns = k * 1_000_000;
            for i in 0..3 {
                let t = k as f64 * 1e-3 + i as f64;
                m.qd_rad_s[i] = (5.0 * t).cos();
                m.payload_column_nm_kg[i] = 2.0 + (5.0 * t).sin();
                // Loads come and go: steps are part of the path.
                let load = if (k / 2000) % 2 == 0 { 0.0 } else { 3.0 };
                m.tau_nm[i] = load * m.payload_column_nm_kg[i] + 0.1 * ((k * 7919) % 13) as f64 / 13.0;
            }
            stage.step(&m, &mut |o| {
                emitted += 1;
                mass = o.mass_kg;
            });
        }
        stage.finish(&mut |_| emitted += 1);
    });
    assert_eq!(counted.count_total, 0, "allocations after new");
    assert_eq!(emitted, 10_000);
    assert!(mass.abs() < 0.2);
}
