//! The pipeline: read, condition, find the minimal set, fit, hold out, account.

use crate::account::{self, Account};
use crate::base::structure;
use crate::columns::{Signal, columns};
use crate::condition::{Plan, Prepared, prepare};
use crate::delay::Delay;
use crate::fit::commanded;
use crate::fit::draft::Data;
use crate::fit::robust::gather;
use crate::forward;
use crate::hold_out::{Context, Split, hold_out};
use crate::options::{Files, Method, Options};
use crate::outcome::Outcome;
use crate::split::Span;
use crate::stream::Stream;
use crate::sums::{Cells, Sums};
use lacuna_interfaces::{BadInput, Recording, RobotFile};
use lacuna_physics::RigidBody;
use rayon::prelude::*;

/// Most blocks of time by default.
const MOST_BLOCKS: f64 = 400.0;

/// Identifies a model from the recordings that `options` names. `progress` hears a share from 0 to 1 and what is done.
///
/// # Errors
/// [`BadInput`] with file and line where a file cannot be used, or in words what the recordings lack.
pub fn identify(options: &Options, progress: &mut dyn FnMut(f64, &str)) -> Result<Outcome, BadInput> {
    progress(0.0, "reading");
    let loaded = lacuna_recording::load_robot(&options.robot)?;
    let files = Files::of(options)?;
    let recordings: Vec<Recording> = files
        .paths
        .par_iter()
        .map(|path| lacuna_recording::read_all(path, &loaded.file))
        .collect::<Vec<_>>()
        .into_iter()
        .collect::<Result<_, _>>()?;
    let body = lacuna_physics::build(&loaded.file, loaded.urdf.as_deref()).map_err(|e| e.in_file(&options.robot))?;
    identify_recordings(options, &loaded.file, body.as_ref(), recordings, &files.spans(), progress)
}

/// [`identify`] on recordings in memory. `ranges` is empty for a holdout, else (training, test) ranges of them.
///
/// # Errors
/// As [`identify`].
pub fn identify_recordings(
    options: &Options,
    robot: &RobotFile,
    body: &dyn RigidBody,
    mut recordings: Vec<Recording>,
    ranges: &(Vec<Span>, Vec<Span>),
    progress: &mut dyn FnMut(f64, &str),
) -> Result<Outcome, BadInput> {
    if options.method == Method::Paper && body.as_delta().is_none() {
        return Err(BadInput::new(
            "method: found paper for a robot of kind \"serial\"; expected one of kind \"delta\"",
        ));
    }
    let count = recordings.len();
    if let Some(s) = ranges.0.iter().chain(&ranges.1).find(|s| s.recording >= count) {
        return Err(BadInput::new(format!("found a range of recording {}; expected 0 to below {count}", s.recording)));
    }
    if options.signal == Signal::MotorMinusLink {
        recordings.iter_mut().try_for_each(|r| subtract_link_torque(r, robot))?;
    }
    progress(0.1, "minimal set of parameters");
    let all = columns(body, options.signal, robot.torque_unit.symbol());
    let structure = structure(body, robot, all)?;
    let refs: Vec<&Recording> = recordings.iter().collect();
    let mut plan = options.conditioning.plan(&refs)?;
    if let Delay::Fixed(d) = options.delay {
        plan.torque_delay_s = checked_delay(d)?;
    }
    progress(0.2, "repairing");
    let prepared: Vec<Prepared> = recordings
        .par_iter_mut()
        .map(|r| prepare(r, robot, &plan))
        .collect::<Vec<_>>()
        .into_iter()
        .collect::<Result<_, _>>()?;
    recordings.iter_mut().for_each(|r| commanded::unwrap(r, robot));
    let stream = Stream::new(body, robot, &structure, &plan, &recordings, &prepared);
    let split = Split::of(&stream, options, ranges)?;
    let cells = Cells::new(&stream, &split.spans(), block_s(options, &plan, &recordings));
    check_rows(&cells, &split)?;
    progress(0.3, "filtering");
    let (sums, store) = gather(&stream, cells, &split.train, options)?;
    check_torques(&stream, &sums)?;
    progress(0.6, "fitting and holding out");
    let names: Vec<String> = recordings.iter().map(|r| r.name.clone()).collect();
    let data = Data { stream: &stream, sums: &sums };
    let held = hold_out(&Context { options, data, store: &store, names: &names }, &split)?;
    progress(0.8, "simulating");
    // The torque that friction alone takes moves nothing that could be simulated.
    let simulable = options.signal == Signal::Motor;
    let forward = if simulable { forward::forward(&stream, &held.tested(&split)) } else { None };
    progress(0.9, "accounting");
    account::account(&Account { options, data, split: &split, held: &held, forward })
}

/// Length of a block of time: so long that blocks are independent, so many that they tell the spread, and not so many that
/// their sums take memory in proportion to the recordings.
fn block_s(options: &Options, plan: &Plan, recordings: &[Recording]) -> f64 {
    let total: f64 = recordings.iter().map(Recording::duration_s).sum();
    let shortest = 8.0 / plan.band_hz;
    let own = (total / 100.0).clamp(shortest, shortest.max(2.0)).max(total / MOST_BLOCKS);
    options.block_s.filter(|b| b.is_finite() && *b > 0.0).unwrap_or(own)
}

fn check_rows(cells: &Cells, split: &Split) -> Result<(), BadInput> {
    if cells.list.is_empty() {
        return Err(BadInput::new("found no rows between the ends of the recordings; expected longer recordings"));
    }
    for (what, spans) in [("train", &split.train), ("test", &split.test)] {
        if !cells.within(spans).contains(&true) {
            return Err(BadInput::new(format!("{what}: found no row in the given range; expected some")));
        }
    }
    Ok(())
}

/// A joint that moves under a torque that never changes: nothing was recorded there, and a fit would take its zero noise for
/// certainty.
fn check_torques(stream: &Stream<'_>, sums: &Sums) -> Result<(), BadInput> {
    for (j, survey) in sums.survey.iter().enumerate().filter(|(_, s)| s.fitted > 0) {
        let constant = |r: &Recording| r.tau_nm[j].windows(2).all(|w| w[0] == w[1]);
        if stream.recordings.iter().all(constant) {
            let level = stream.recordings.iter().find_map(|r| r.tau_nm[j].first()).copied().unwrap_or(0.0);
            return Err(BadInput::new(format!(
                "joint {} ({}): the torque is {level} {} in every sample, though the joint moves at up to {:.3} rad/s; \
                 expected a measured torque",
                j + 1,
                stream.robot.joints[j],
                stream.robot.torque_unit.symbol(),
                survey.fastest
            )));
        }
    }
    Ok(())
}

fn checked_delay(d: f64) -> Result<f64, BadInput> {
    if d.is_finite() && d.abs() < 1.0 {
        return Ok(d);
    }
    Err(BadInput::new(format!("delay: found {d} s; expected a number of seconds below 1")))
}

fn subtract_link_torque(recording: &mut Recording, robot: &RobotFile) -> Result<(), BadInput> {
    let names = &robot.columns.link_torque;
    if names.len() != robot.joint_count() {
        return Err(BadInput::new(format!(
            "signal motor_minus_link: found {} columns in columns.link_torque of the robot file; expected {}, one per joint",
            names.len(),
            robot.joint_count()
        )));
    }
    for (j, name) in names.iter().enumerate() {
        let sensor = recording.extra.get(name).ok_or_else(|| {
            BadInput::new(format!("found no column {name}; expected the link torque of joint {}", j + 1))
                .in_file(&recording.name)
        })?;
        if let Some(k) = sensor.iter().position(|v| !v.is_finite()) {
            return Err(BadInput::new(format!("found {name} = {} in sample {}; expected a number", sensor[k], k + 1))
                .in_file(&recording.name));
        }
        for (tau, s) in recording.tau_nm[j].iter_mut().zip(sensor) {
            *tau -= s;
        }
    }
    Ok(())
}
