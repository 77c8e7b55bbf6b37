//! The pipeline: read, condition, find the minimal set, fit, hold out, account.

use crate::account::{self, Account};
use crate::base::{Structure, structure};
use crate::bristle;
use crate::columns::{Signal, columns};
use crate::condition::{Conditioned, Conditioning, Plan, condition};
use crate::consistent::{self, Consistent};
use crate::delay::{self, Delay, DelayEstimate};
use crate::evaluate::{Score, Tally, Which, training_scale};
use crate::fit::{FitSettings, Solution, fit, predict};
use crate::outcome::Outcome;
use crate::paper::{self, PaperModels, PaperResult};
use crate::rows::{Rows, rows};
use crate::split::{FileRange, Fold, Holdout, Span, TimeRange, folds, select};
use lacuna_interfaces::{BadInput, Recording, RobotFile};
use lacuna_physics::RigidBody;
use nalgebra::DVector;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Which estimator makes the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// All base parameters and friction of all joints in one weighted, robust fit.
    #[default]
    Pooled,
    /// The paper's grid search and averages (Delta only).
    Paper,
}

impl std::str::FromStr for Method {
    type Err = BadInput;

    fn from_str(text: &str) -> Result<Self, BadInput> {
        match text {
            "pooled" => Ok(Self::Pooled),
            "paper" => Ok(Self::Paper),
            _ => Err(BadInput::new(format!("method: found \"{text}\"; expected pooled or paper"))),
        }
    }
}

/// What a user may choose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Robot file.
    pub robot: PathBuf,
    /// Recordings to train on and to hold out in turn; not together with `train` and `test`.
    pub recordings: Vec<PathBuf>,
    /// Recordings, or parts of them, to train on.
    pub train: Vec<FileRange>,
    /// Recordings, or parts of them, to test on.
    pub test: Vec<FileRange>,
    /// How to hold out. Default: by recording; by halves of time for a single one.
    pub holdout: Option<Holdout>,
    /// Estimator.
    pub method: Method,
    /// Which torque is modelled.
    pub signal: Signal,
    /// Bound the influence of outliers.
    pub robust: bool,
    /// Fit with positive definite pseudo-inertias and positive friction; the cost in fit is accounted for.
    pub consistent: bool,
    /// Delay between torque and position.
    pub delay: Delay,
    /// Filters and masks.
    pub conditioning: Conditioning,
    /// Length of a block of time behind the intervals [s]. Default: a hundredth of the data, from eight periods of the
    /// band to 2 s.
    pub block_s: Option<f64>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            robot: PathBuf::new(),
            recordings: Vec::new(),
            train: Vec::new(),
            test: Vec::new(),
            holdout: None,
            method: Method::Pooled,
            signal: Signal::Motor,
            robust: true,
            consistent: false,
            delay: Delay::Estimate,
            conditioning: Conditioning::default(),
            block_s: None,
        }
    }
}

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
    if options.method == crate::Method::Paper && body.as_delta().is_none() {
        return Err(BadInput::new(
            "method: found paper for a robot of kind \"serial\"; expected one of kind \"delta\"",
        ));
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
    progress(0.2, "filtering");
    let mut data = Data::new(robot, body, &structure, &recordings, plan, options.block_s)?;
    let mut split = Split::of(&data.rows, options, recordings.len(), ranges, &data.plan)?;
    let settings = FitSettings { robust: options.robust, standstill: false };
    progress(0.5, "fitting");
    let (mut solution, mut widths) = data.fit(&structure, &split.train, settings)?;
    let mut delay = None;
    if options.delay != Delay::Off {
        let undone = data.plan.torque_delay_s;
        delay = delay::estimate(&structure, &data.rows, &split.train, &solution, undone);
        if options.delay == Delay::Estimate && delay.is_some_and(|d| worth_undoing(&d, &data)) {
            let late = delay.map_or(0.0, |d| d.delay_s);
            let plan = Plan { torque_delay_s: late, ..data.plan.clone() };
            data = Data::new(robot, body, &structure, &recordings, plan, options.block_s)?;
            split = Split::of(&data.rows, options, recordings.len(), ranges, &data.plan)?;
            (solution, widths) = data.fit(&structure, &split.train, settings)?;
            delay = delay::estimate(&structure, &data.rows, &split.train, &solution, late);
        }
    }
    progress(0.7, "holding out");
    let names: Vec<String> = recordings.iter().map(|r| r.name.clone()).collect();
    let held = hold_out(options, body, &structure, &data.rows, &split, &solution, &names)?;
    progress(0.9, "accounting");
    account::account(&Account {
        options,
        robot,
        structure: &structure,
        conditioned: &data.conditioned,
        rows: &data.rows,
        plan: &data.plan,
        split: &split,
        solution: &solution,
        held: &held,
        delay,
        bristle_rad: &widths,
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

/// The distinct files of the options and the ranges in them.
struct Files {
    paths: Vec<PathBuf>,
    train: Vec<(usize, FileRange)>,
    test: Vec<(usize, FileRange)>,
}

impl Files {
    fn of(options: &Options) -> Result<Self, BadInput> {
        let explicit = !(options.train.is_empty() && options.test.is_empty());
        if explicit && (options.train.is_empty() || options.test.is_empty()) {
            return Err(BadInput::new(format!(
                "found {} training and {} test recordings; expected both, or recordings alone to hold out in turn",
                options.train.len(),
                options.test.len()
            )));
        }
        if explicit && (!options.recordings.is_empty() || options.holdout.is_some()) {
            return Err(BadInput::new(
                "found recordings or a holdout together with train and test; expected one way of splitting",
            ));
        }
        if !explicit && options.recordings.is_empty() {
            return Err(BadInput::new("found no recording; expected at least one"));
        }
        let mut paths: Vec<PathBuf> = Vec::new();
        let mut index = |path: &PathBuf| {
            paths.iter().position(|p| p == path).unwrap_or_else(|| {
                paths.push(path.clone());
                paths.len() - 1
            })
        };
        options.recordings.iter().for_each(|p| {
            index(p);
        });
        let mut of = |list: &[FileRange]| list.iter().map(|r| (index(&r.file), r.clone())).collect();
        let (train, test) = (of(&options.train), of(&options.test));
        Ok(Self { paths, train, test })
    }

    fn spans(&self) -> (Vec<Span>, Vec<Span>) {
        let of = |list: &[(usize, FileRange)]| {
            list.iter()
                .map(|(recording, r)| Span {
                    recording: *recording,
                    from_s: r.from_s.unwrap_or(f64::NEG_INFINITY),
                    to_s: r.to_s.unwrap_or(f64::INFINITY),
                })
                .collect()
        };
        (of(&self.train), of(&self.test))
    }
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
}

impl Data {
    /// Chooses the joints' bristles by a first, plain fit, and fits.
    fn fit(
        &mut self,
        structure: &Structure,
        train: &[bool],
        settings: FitSettings,
    ) -> Result<(Solution, Vec<Option<f64>>), BadInput> {
        let mut widths = vec![None; self.rows.joints.len()];
        if self.plan.bristle {
            let first = fit(structure, &self.rows, train, FitSettings { robust: false, ..settings })?;
            widths = bristle::choose(structure, &self.conditioned, &mut self.rows, train, &first)?;
        }
        Ok((fit(structure, &self.rows, train, settings)?, widths))
    }
}

/// The rows of the final fit and the folds of the held-out error.
pub(crate) struct Split {
    pub(crate) train: Vec<bool>,
    pub(crate) folds: Vec<Fold>,
    pub(crate) name: String,
    pub(crate) train_ranges: Vec<Span>,
    pub(crate) test_ranges: Vec<Span>,
}

impl Split {
    fn of(
        rows: &Rows,
        options: &Options,
        recordings: usize,
        ranges: &(Vec<Span>, Vec<Span>),
        plan: &Plan,
    ) -> Result<Self, BadInput> {
        let (train, test) = ranges;
        if !train.is_empty() {
            let fold = Fold { train: select(rows, train), test: select(rows, test) };
            for (what, mask) in [("train", &fold.train), ("test", &fold.test)] {
                if !mask.contains(&true) {
                    return Err(BadInput::new(format!("{what}: found no row in the given range; expected some")));
                }
            }
            return Ok(Self {
                train: fold.train.clone(),
                folds: vec![fold],
                name: "files".to_owned(),
                train_ranges: train.clone(),
                test_ranges: test.clone(),
            });
        }
        let holdout = options.holdout.unwrap_or(if recordings > 1 { Holdout::Recordings } else { Holdout::Halves });
        let name = match holdout {
            Holdout::Recordings => "recordings".to_owned(),
            Holdout::Halves => "halves".to_owned(),
            Holdout::Kfold(n) => format!("kfold={n}"),
        };
        let whole: Vec<Span> = (0..recordings)
            .map(|recording| Span { recording, from_s: f64::NEG_INFINITY, to_s: f64::INFINITY })
            .collect();
        Ok(Self {
            train: vec![true; rows.len()],
            folds: folds(rows, holdout, recordings, 2.0 / plan.band_hz)?,
            name,
            train_ranges: whole.clone(),
            test_ranges: whole,
        })
    }
}

/// Held-out figures and curves.
pub(crate) struct Held {
    pub(crate) score: Score,
    pub(crate) folds: Vec<f64>,
    pub(crate) nominal: Option<f64>,
    pub(crate) with_standstill: Option<f64>,
    /// Model torque per joint and row: of the fold that holds the row out, else of the final fit.
    pub(crate) model: Vec<Vec<f64>>,
    pub(crate) held_out: Vec<bool>,
    pub(crate) paper: Option<(PaperModels, PaperResult)>,
    /// The constrained fit, and the held-out error of the free one.
    pub(crate) consistent: Option<(Consistent, f64)>,
}

fn hold_out(
    options: &Options,
    body: &dyn RigidBody,
    structure: &Structure,
    rows: &Rows,
    split: &Split,
    solution: &Solution,
    names: &[String],
) -> Result<Held, BadInput> {
    let n = rows.joints.len();
    let nominal = DVector::from_iterator(structure.base.len(), structure.base.iter().map(|b| b.nominal));
    let by_paper = options.method == Method::Paper;
    let final_paper = if by_paper { Some(paper::fit(structure, rows, &split.train, names)?) } else { None };
    let final_consistent = if options.consistent { Some(consistent::fit(body, structure, solution)?) } else { None };
    let final_beta = match (&final_paper, &final_consistent) {
        (Some((models, _)), _) => &models.with_friction,
        (None, Some(c)) => &c.beta,
        (None, None) => &solution.beta,
    };
    let mut model: Vec<Vec<f64>> = (0..n).map(|j| predict(structure, rows, final_beta, j)).collect();
    let mut held_out = vec![false; rows.len()];
    let (mut tally, mut bare, mut standing) = (Tally::default(), Tally::default(), Tally::default());
    let mut free = Tally::default();
    let mut table: [Tally; 4] = Default::default();
    let mut table_moving: [Tally; 4] = Default::default();
    let mut folds = Vec::new();
    let stands = rows.joints.iter().any(|j| {
        let idle = j.usable.iter().zip(&j.counted).filter(|(u, c)| **u && !**c).count();
        idle * 20 > rows.len()
    });
    for fold in &split.folds {
        let same = fold.train == split.train;
        let settings = FitSettings { robust: options.robust, standstill: false };
        let own = if same { solution.clone() } else { fit(structure, rows, &fold.train, settings)? };
        let at_rest = FitSettings { standstill: true, ..settings };
        let rested = if stands { Some(fit(structure, rows, &fold.train, at_rest)?) } else { None };
        let papers = if by_paper { Some(paper::fit(structure, rows, &fold.train, names)?.0) } else { None };
        let bound =
            if options.consistent && !by_paper { Some(consistent::fit(body, structure, &own)?.beta) } else { None };
        let beta = papers.as_ref().map(|m| &m.with_friction).or(bound.as_ref()).unwrap_or(&own.beta);
        let scale = training_scale(rows, &fold.train);
        let mut alone = Tally::default();
        for j in 0..n {
            let add = |to: &mut Tally, beta: &DVector<f64>, which: Which| {
                let predicted = predict(structure, rows, beta, j);
                to.add(rows, j, &predicted, &fold.test, which, scale[j]);
                predicted
            };
            let predicted = add(&mut tally, beta, Which::Counted);
            add(&mut alone, beta, Which::Counted);
            add(&mut bare, &nominal, Which::Counted);
            if options.consistent {
                add(&mut free, &own.beta, Which::Counted);
            }
            if let Some(rested) = &rested {
                add(&mut standing, &rested.beta, Which::Usable);
            }
            if let Some(p) = &papers {
                let models = [&p.nominal, &p.identified, &p.with_friction, &own.beta];
                for (i, b) in models.into_iter().enumerate() {
                    add(&mut table[i], b, Which::Usable);
                    add(&mut table_moving[i], b, Which::Counted);
                }
            }
            for k in (0..rows.len()).filter(|&k| fold.test[k]) {
                model[j][k] = predicted[k];
                held_out[k] = true;
            }
        }
        if let Some(s) = alone.score() {
            folds.push(s.relative_error);
        }
    }
    let score = tally.score().ok_or_else(|| {
        BadInput::new("found no moving joint in the test rows; expected motion there (or a moving speed of 0)")
    })?;
    let has_masses = nominal.iter().any(|v| *v != 0.0);
    let paper = final_paper.map(|(models, mut result)| {
        let names = ["M_KH", "M_Id", "M_Id+F", "pooled"];
        result.table1 = account::error_tables(&names, &table);
        result.table1_moving = account::error_tables(&names, &table_moving);
        (models, result)
    });
    Ok(Held {
        score,
        folds,
        nominal: bare.score().map(|s| s.relative_error).filter(|_| has_masses),
        with_standstill: standing.score().map(|s| s.relative_error),
        model,
        held_out,
        paper,
        consistent: final_consistent.zip(free.score().map(|s| s.relative_error)),
    })
}

/// Spans with their file names and finite ends.
pub(crate) fn time_ranges(spans: &[Span], names: &[String], conditioned: &[Conditioned]) -> Vec<TimeRange> {
    spans
        .iter()
        .map(|s| {
            let stretches = &conditioned[s.recording].stretches;
            let first = stretches.first().map_or(0.0, |x| x.start_s);
            let last = stretches.last().map_or(0.0, |x| x.time_s(x.len().saturating_sub(1)));
            TimeRange { file: names[s.recording].clone(), from_s: s.from_s.max(first), to_s: s.to_s.min(last) }
        })
        .collect()
}
