//! The input URDF with identified inertials and friction: for planners and simulators that read nothing else.

use crate::outcome::Outcome;
use lacuna_interfaces::robot::TorqueUnit;
use lacuna_interfaces::{BadInput, RobotFile};
use lacuna_physics::serial::urdf::write::{LinkValues, with_inertials};

/// The text of `urdf` with the links and joint friction of a physically consistent identification. `None` where there is
/// nothing to write: the fit was not constrained to links that can exist, or torques are not in Nm.
///
/// Torques show combinations of inertial parameters only. The constrained fit takes, of all links that could exist and give
/// these combinations, those closest to the robot file's (log-determinant divergence, [`crate::consistent`]).
///
/// # Errors
/// [`BadInput`] if the URDF cannot be read, or a link of the fit lies on the border of what can exist, closer than the
/// numbers resolve.
pub fn model_urdf(outcome: &Outcome, robot: &RobotFile, urdf: &str) -> Result<Option<String>, BadInput> {
    if outcome.identification.consistency.is_none() || robot.torque_unit != TorqueUnit::Nm {
        return Ok(None);
    }
    let body = lacuna_physics::build(robot, Some(urdf))?;
    if body.as_serial().is_none() {
        return Ok(None);
    }
    let model = &outcome.model;
    let pi = lacuna_physics::parameters_of(body.as_ref(), &model.rigid_body)?;
    let mut links = LinkValues::of_parameters(&pi);
    for (j, link) in links.iter_mut().enumerate() {
        link.friction = model.friction.f_v.get(j).copied().zip(model.friction.f_c.get(j).copied());
    }
    let mut remarks = vec![
        format!("Inertials and joint friction: {}.", model.origin),
        "Joint torques show combinations of inertial parameters alone. Among the links that give the combinations found and".to_owned(),
        "could exist, these are the closest to the input's: a single value here may be convention, not measurement.".to_owned(),
        "model.toml and identification.json say which parameters are supported by the recordings.".to_owned(),
    ];
    if model.friction.offset.iter().any(|o| *o != 0.0) {
        let offsets: Vec<String> = model.friction.offset.iter().map(|o| format!("{o:.4}")).collect();
        remarks.push(format!("Not in this file: constant torque offsets per joint {} Nm.", offsets.join(", ")));
    }
    with_inertials(urdf, &robot.joints, &links, &remarks).map(Some)
}
