//! The same smoother over a whole recording, forward and backward.

use crate::config::{Config, Known};
use lacuna_estimation::kalman::{Noise, Settings, Smoothed, smooth};
use lacuna_interfaces::{BadInput, ModelFile, Recording, RobotFile};

/// Most samples of a recording that noise is estimated from.
const MOST_LOOKED_AT: usize = 1 << 16;

/// The settings with which the smoother runs over `recording`: what the configuration leaves open is found
/// from the recording's own first 65 536 samples (on the stream: from the first stretch).
///
/// # Errors
/// [`BadInput`] if configuration, robot, model and recording do not fit together.
pub fn settings_for(
    recording: &Recording,
    config: &Config,
    robot: &RobotFile,
    model: Option<&ModelFile>,
) -> Result<Settings, BadInput> {
    let known = Known::new(config.clone(), robot, model)?;
    let n = robot.joint_count();
    if recording.q_rad.len() != n {
        return Err(BadInput::new(format!(
            "recording {}: found {} joints; expected {n}, the robot file's",
            recording.name,
            recording.q_rad.len()
        )));
    }
    if let Some(q) = recording.q_rad.iter().find(|q| q.len() != recording.len()) {
        return Err(BadInput::new(format!(
            "recording {}: found {} positions; expected {}, as many as times",
            recording.name,
            q.len(),
            recording.len()
        )));
    }
    let period_s = known.period_s().or_else(|| recording.median_period_s()).unwrap_or(1e-3);
    let most = recording.len().min(MOST_LOOKED_AT);
    let noise: Vec<Noise> = recording
        .q_rad
        .iter()
        .enumerate()
        .map(|(j, q)| known.noise(j, period_s, &recording.t_s[..most], &q[..most]))
        .collect();
    let settings = known.settings(noise, period_s);
    settings.validate()?;
    Ok(settings)
}

/// Smooths a recording forward and backward, with the configuration of the stage.
///
/// # Errors
/// As [`settings_for`], and [`BadInput`] for time that does not increase or positions that are not finite.
pub fn smooth_recording(
    recording: &Recording,
    config: &Config,
    robot: &RobotFile,
    model: Option<&ModelFile>,
) -> Result<Smoothed, BadInput> {
    let settings = settings_for(recording, config, robot, model)?;
    let views: Vec<&[f64]> = recording.q_rad.iter().map(Vec::as_slice).collect();
    smooth(&settings, &recording.t_s, &views).map_err(|e| BadInput::new(format!("recording {}: {e}", recording.name)))
}
