//! A recording through the stage libraries without processes: source, smoother, torque and friction, exactly the
//! `step`s that the graph of `launch/replay.toml` runs, with that graph's settings.

use lacuna_friction::Friction;
use lacuna_interfaces::{BadInput, FrictionTorque, JointMeasured, Repair, Stage, StageContext};
use lacuna_smoother::Smoother;
use lacuna_source::{Config as SourceConfig, Rate, Source};
use lacuna_torque::Torque;
use std::path::Path;

/// How much future a smoothed sample may use [s]: `lag_s` of `launch/replay.toml`.
pub const LAG_S: f64 = 0.03;

/// Runs `path` through source, smoother, torque and friction; `each` hears every sample. Memory does not grow with the
/// recording.
///
/// # Errors
/// [`BadInput`] with file and line where the recording cannot be read, or if robot and model do not fit together.
pub fn replay(
    path: &Path,
    context: &StageContext<'_>,
    lag_s: f64,
    each: &mut dyn FnMut(&FrictionTorque),
) -> Result<Vec<Repair>, BadInput> {
    let config = SourceConfig {
        interface: None,
        recording: vec![path.to_path_buf()],
        rate: Rate::Max,
        from_s: 0.0,
        to_s: None,
        limit: None,
        between_s: 1.0,
        joints: Vec::new(),
        topic: None,
        time: Default::default(),
    };
    let mut source = Source::new(config, context.robot)?;
    let smoothing = lacuna_smoother::Config { lag_s: Some(lag_s), ..Default::default() };
    let mut smoother = Smoother::new(smoothing, context)?;
    let mut torque = Torque::new(Default::default(), context)?;
    let mut friction = Friction::new(Default::default(), context)?;
    let mut on = |smoothed: &_| torque.step(smoothed, &mut |t| friction.step(t, &mut *each));
    let mut sample = JointMeasured::default();
    while source.next_sample(&mut sample)? {
        smoother.step(&sample, &mut on);
    }
    // Torque and friction hold nothing back.
    smoother.finish(&mut on);
    Ok(source.repairs())
}
