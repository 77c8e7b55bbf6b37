//! Forward simulation under the identified model, on recordings of a plant that shares no code with it.

mod common;

use common::{ARM, DELTA};
use lacuna_identify::{Options, Signal, identify_recordings};
use lacuna_interfaces::RobotFile;
use lacuna_simulate::config::{SimulationConfig, TrajectoryGroup};
use lacuna_simulate::reference::Kinds;
use lacuna_simulate::simulate;

#[test]
fn the_identified_model_predicts_what_the_plant_does() {
    for text in [DELTA, ARM] {
        let robot = RobotFile::parse(text).unwrap();
        let body = lacuna_physics::build(&robot, None).unwrap();
        let group = |kind| TrajectoryGroup { kind, duration_s: 5.0, count: 2, intensity: 0.8 };
        let config = SimulationConfig {
            seed: 3,
            mass_error: 0.1,
            trajectories: vec![group(Kinds::Fourier), group(Kinds::PointToPoint)],
            ..SimulationConfig::default()
        };
        let recordings = simulate(&robot, None, &config).unwrap().recordings;
        let none = (Vec::new(), Vec::new());
        let identified = |options: &Options| {
            identify_recordings(options, &robot, body.as_ref(), recordings.clone(), &none, &mut |_, _| ())
        };
        let forward = identified(&Options::default()).unwrap().identification.forward.expect("windows");
        eprintln!("{}: {forward:?}", robot.name);
        let (own, nominal) = (&forward.identified, forward.nominal.as_ref().expect("masses"));
        assert!(own.windows >= 40 && own.failed == 0 && nominal.windows == own.windows);
        assert_eq!(forward.horizons_s, [0.05, 0.1, 0.2]);
        for j in 0..robot.joint_count() {
            // Farther ahead is harder.
            assert!(own.rms_rad[0][j] < own.rms_rad[1][j] && own.rms_rad[1][j] < own.rms_rad[2][j]);
            // No friction and masses a tenth off miss the motion; the identified model does not.
            let (own, nominal) = (own.rms_rad[2][j], nominal.rms_rad[2][j]);
            assert!(own < 0.15 * nominal && own < 0.1 * forward.held_velocity.rms_rad[2][j], "{own} {nominal}");
        }
        // Friction alone moves nothing: no figure rather than a wrong one. (These recordings have no such sensor.)
        assert!(identified(&Options { signal: Signal::MotorMinusLink, ..Options::default() }).is_err());
    }
}
