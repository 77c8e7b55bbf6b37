//! The pipeline: read, condition, find the minimal set, fit, hold out, account.

use crate::account::{self, Account};
use crate::base::{Structure, structure};
use crate::columns::{Signal, columns};
use crate::condition::{Conditioned, Plan, condition};
use crate::delay::{self, Delay, DelayEstimate};
use crate::hold_out::{Context, Fitted, Split, hold_out};
use crate::options::{Files, Method, Options};
use crate::outcome::Outcome;
use crate::rows::{Rows, rows};
use crate::split::Span;
use lacuna_interfaces::{BadInput, Recording, RobotFile};
use lacuna_physics::RigidBody;
use rayon::prelude::*;

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
    let names: Vec<String> = recordings.iter().map(|r| r.name.clone()).collect();
    progress(0.2, "filtering");
    let mut data = Data::new(robot, body, &structure, &recordings, plan, options.block_s)?;
    let mut split = Split::of(&data.rows, options, recordings.len(), ranges, &data.plan)?;
    progress(0.5, "fitting");
    let mut fitted = data.context(options, body, &structure, &names).fit(&split.train)?;
    let mut delay = None;
    if options.delay != Delay::Off {
        let estimate = |fitted: &Fitted, split: &Split, undone| {
            delay::estimate(&structure, &fitted.rows, &split.train, &fitted.solution, undone)
        };
        delay = estimate(&fitted, &split, data.plan.torque_delay_s);
        if let (Delay::Estimate, Some(late)) = (options.delay, delay.filter(|d| worth_undoing(d, &data))) {
            let plan = Plan { torque_delay_s: late.delay_s, ..data.plan.clone() };
            data = Data::new(robot, body, &structure, &recordings, plan, options.block_s)?;
            split = Split::of(&data.rows, options, recordings.len(), ranges, &data.plan)?;
            fitted = data.context(options, body, &structure, &names).fit(&split.train)?;
            delay = estimate(&fitted, &split, late.delay_s);
        }
    }
    progress(0.7, "holding out");
    let held = hold_out(&data.context(options, body, &structure, &names), &split, &fitted)?;
    progress(0.9, "accounting");
    account::account(&Account {
        options,
        robot,
        structure: &structure,
        conditioned: &data.conditioned,
        plan: &data.plan,
        split: &split,
        fitted: &fitted,
        held: &held,
        delay,
        names: &names,
    })
}

fn checked_delay(d: f64) -> Result<f64, BadInput> {
    if d.is_finite() && d.abs() < 1.0 {
        return Ok(d);
    }
    Err(BadInput::new(format!("delay: found {d} s; expected a number of seconds below 1")))
}

/// A delay is undone if it is certain, worth the trouble and one that sampling explains.
fn worth_undoing(d: &DelayEstimate, data: &Data) -> bool {
    let period = data.conditioned.iter().map(|c| 1.0 / c.sample_rate_hz).fold(0.0, f64::max);
    let size = d.delay_s.abs();
    size > 4.0 * d.standard_error_s && size > 0.02 * period && size <= 2.0 * period
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

/// Conditioned recordings and their rows.
struct Data {
    plan: Plan,
    conditioned: Vec<Conditioned>,
    rows: Rows,
}

impl Data {
    fn new(
        robot: &RobotFile,
        body: &dyn RigidBody,
        structure: &Structure,
        recordings: &[Recording],
        plan: Plan,
        block_s: Option<f64>,
    ) -> Result<Self, BadInput> {
        let conditioned: Vec<Conditioned> = recordings
            .par_iter()
            .map(|r| condition(r, robot, &plan))
            .collect::<Vec<_>>()
            .into_iter()
            .collect::<Result<_, _>>()?;
        let total: f64 = recordings.iter().map(Recording::duration_s).sum();
        let shortest = 8.0 / plan.band_hz;
        let block_s =
            block_s.filter(|b| b.is_finite() && *b > 0.0).unwrap_or((total / 100.0).clamp(shortest, shortest.max(2.0)));
        let rows = rows(body, structure, &conditioned, &plan, block_s)?;
        if rows.is_empty() {
            return Err(BadInput::new("found no rows between the ends of the recordings; expected longer recordings"));
        }
        Ok(Self { plan, conditioned, rows })
    }

    fn context<'a>(
        &'a self,
        options: &'a Options,
        body: &'a dyn RigidBody,
        structure: &'a Structure,
        names: &'a [String],
    ) -> Context<'a> {
        Context { options, body, structure, conditioned: &self.conditioned, rows: &self.rows, names }
    }
}
