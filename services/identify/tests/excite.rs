//! Excitation trajectories keep the limits and pay off in an identification.

use lacuna_identify::excite::{ExciteOptions, excite};
use lacuna_interfaces::RobotFile;

const DELTA: &str = "kind = \"delta\"\nname = \"test\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n[mass]\n\
    platform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\nrotor_inertia = 0.06\n\
    [limits]\nq_min_rad = -0.4\nq_max_rad = 1.1\nqd_max_rad_s = 6.0\nqdd_max_rad_s2 = 60.0\n";

const ARM: &str = "kind = \"serial\"\nname = \"arm\"\njoints = [\"a\", \"b\", \"c\"]\n\
    [[dh]]\nd = 0.3\nalpha = 1.5707963267948966\n[[dh]]\na = 0.3\n[[dh]]\na = 0.25\n\
    [limits]\nq_min_rad = [-2.0, -1.0, -1.5]\nq_max_rad = [2.0, 1.5, 1.5]\nqd_max_rad_s = 2.5\nqdd_max_rad_s2 = 8.0\n";

#[test]
fn limits_hold_and_the_information_grows() {
    let workspace = [[-0.35, -0.35, -1.0], [0.35, 0.35, -0.5]];
    for (text, workspace_m) in [(DELTA, Some(workspace)), (ARM, None)] {
        let robot = RobotFile::parse(text).unwrap();
        let body = lacuna_physics::build(&robot, None).unwrap();
        let options = ExciteOptions { workspace_m, candidates: 1200, ..ExciteOptions::default() };
        let start = std::time::Instant::now();
        let e = excite(&robot, body.as_ref(), &options, &mut |_| ()).unwrap();
        eprintln!(
            "{}: condition {:.1} -> {:.1}, log det {:.1} -> {:.1}, standard errors / {:.2}, {} feasible, {:.2} s",
            robot.name,
            e.before.condition,
            e.after.condition,
            e.before.log_det,
            e.after.log_det,
            e.error_ratio,
            e.feasible,
            start.elapsed().as_secs_f64()
        );
        assert!(e.after.log_det > e.before.log_det + 5.0 && e.error_ratio > 1.2);
        let limit =
            |list: &Option<lacuna_interfaces::robot::PerJoint>, j: usize| list.as_ref().unwrap().get(j).unwrap();
        for k in 0..20_000 {
            let (q, qd, qdd) = e.motion.at(k as f64 * 0.5e-3);
            for j in 0..3 {
                let l = &robot.limits;
                assert!(q[j] >= limit(&l.q_min_rad, j) && q[j] <= limit(&l.q_max_rad, j));
                assert!(qd[j].abs() <= limit(&l.qd_max_rad_s, j) && qdd[j].abs() <= limit(&l.qdd_max_rad_s2, j));
            }
            if let Some([low, high]) = workspace_m {
                let tip = body.tip(&q).unwrap().position_m;
                assert!((0..3).all(|i| tip[i] >= low[i] - 5e-3 && tip[i] <= high[i] + 5e-3), "{tip:?}");
            }
        }
        let (_, qd, qdd) = e.motion.at(0.0);
        assert!(qd.iter().chain(&qdd).all(|v| v.abs() < 1e-9), "starts at rest");
        assert_eq!(excite(&robot, body.as_ref(), &options, &mut |_| ()).unwrap(), e, "deterministic by seed");
        let mut text = Vec::new();
        e.motion.write_csv(100.0, &mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        assert!(text.starts_with("t,q1,q2,q3,qd1,") && text.lines().count() == 1002);
    }
}

#[test]
fn impossible_wishes_are_refused_in_words() {
    let robot = RobotFile::parse(ARM).unwrap();
    let body = lacuna_physics::build(&robot, None).unwrap();
    let fails =
        |robot: &RobotFile, o: ExciteOptions| excite(robot, body.as_ref(), &o, &mut |_| ()).unwrap_err().to_string();
    let mut unlimited = robot.clone();
    unlimited.limits.qd_max_rad_s = None;
    assert!(fails(&unlimited, ExciteOptions::default()).contains("limits.qd_max_rad_s: found none for joint 1 (a)"));
    let mut inverted = robot.clone();
    inverted.limits.q_max_rad = Some(lacuna_interfaces::robot::PerJoint::All(-3.0));
    assert!(fails(&inverted, ExciteOptions::default()).contains("expected a range"));
    let tiny = Some([[5.0, 5.0, 5.0], [5.1, 5.1, 5.1]]);
    let o = ExciteOptions { workspace_m: tiny, candidates: 32, ..ExciteOptions::default() };
    assert!(fails(&robot, o).contains("no motion within reach and workspace"));
    assert!(fails(&robot, ExciteOptions { harmonics: 1, ..ExciteOptions::default() }).contains("2 to 20"));
    assert!(fails(&robot, ExciteOptions { period_s: f64::NAN, ..ExciteOptions::default() }).contains("period_s"));
}
