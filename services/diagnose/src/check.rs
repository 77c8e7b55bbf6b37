//! What recordings must be before anything is computed from them.

use lacuna_interfaces::{BadInput, Recording, RobotFile};
use std::cmp::Ordering;

/// Fewest samples of a recording.
const LEAST: usize = 64;

/// Refuses recordings that do not fit the robot, are too short, or hold no signal.
///
/// # Errors
/// [`BadInput`] with recording, what was found, and what was expected.
pub(crate) fn recordings(robot: &RobotFile, list: &[Recording]) -> Result<(), BadInput> {
    if list.is_empty() {
        return Err(BadInput::new("recordings: found none; expected one at least"));
    }
    for r in list {
        one(robot, r).map_err(|what| BadInput::new(what).in_file(&r.name))?;
    }
    let unit = robot.torque_unit.symbol();
    for (j, joint) in robot.joints.iter().enumerate() {
        let mut all = list.iter().filter_map(|r| r.tau_nm.get(j)).flatten();
        let Some(first) = all.next() else { continue };
        if all.all(|v| v == first) {
            return Err(BadInput::new(format!(
                "joint {joint}: found a torque of {first} {unit} in every sample; expected a measured torque"
            )));
        }
    }
    Ok(())
}

fn one(robot: &RobotFile, r: &Recording) -> Result<(), String> {
    let n = robot.joint_count();
    if (r.q_rad.len(), r.tau_nm.len()) != (n, n) {
        return Err(format!(
            "found {} joints' positions and {} torques; expected {n} of each, {}",
            r.q_rad.len(),
            r.tau_nm.len(),
            robot.joints.join(", ")
        ));
    }
    if r.len() < LEAST {
        return Err(format!("found {} samples; expected {LEAST} at least", r.len()));
    }
    let signals = [("position", &r.q_rad), ("torque", &r.tau_nm)];
    for (name, list) in signals {
        for (signal, joint) in list.iter().zip(&robot.joints) {
            if signal.len() != r.len() {
                return Err(format!(
                    "joint {joint}: found {} samples of its {name}; expected {}, one per time",
                    signal.len(),
                    r.len()
                ));
            }
            if let Some(k) = signal.iter().position(|v| !v.is_finite()) {
                return Err(format!(
                    "joint {joint}: found {name} {} in sample {}; expected a number",
                    signal[k],
                    k + 1
                ));
            }
        }
    }
    if let Some(w) = r.t_s.windows(2).position(|w| w[1].partial_cmp(&w[0]) != Some(Ordering::Greater)) {
        return Err(format!("found a time that does not rise after sample {}; expected rising times", w + 1));
    }
    Ok(())
}
