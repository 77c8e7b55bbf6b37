//! After `new` the stage does not allocate, in quiet and under alarm.

use lacuna_interfaces::{ModelFile, PayloadEstimate, RobotFile, Stage, StageContext};
use lacuna_monitor::{Config, Monitor};

#[test]
fn step_and_finish() {
    let robot = RobotFile::parse(
        "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
         [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\n",
    )
    .unwrap();
    let mut model = ModelFile::nominal(&robot);
    model.noise.sd_tau_nm = vec![0.1; 3];
    let context = StageContext { robot: &robot, urdf: None, model: Some(&model) };
    let mut stage = Monitor::new(Config::default(), &context).unwrap();
    let (mut emitted, mut alarms) = (0, 0);
    let counted = allocation_counter::measure(|| {
        for k in 0..20_000i64 {
            let mut m = PayloadEstimate::default();
            m.header.stamp_ns = k * 1_000_000;
            for i in 0..3 {
                let t = k as f64 * 1e-3 + i as f64;
                m.q_rad[i] = 0.2 * (5.0 * t).sin();
                m.qd_rad_s[i] = (5.0 * t).cos();
                // Friction comes and goes.
                let rise = if (k / 4000) % 2 == 0 { 0.0 } else { m.qd_rad_s[i].signum() };
                m.residual_nm[i] = rise + 0.1 * ((k * 7919) % 13 - 6) as f64 / 6.0;
            }
            stage.step(&m, &mut |o| {
                emitted += 1;
                alarms += o.alarm.count_ones();
            });
        }
        stage.finish(&mut |_| emitted += 1);
    });
    assert_eq!(counted.count_total, 0, "allocations after new");
    assert_eq!(emitted, 20_000);
    assert!(alarms > 1000);
}
