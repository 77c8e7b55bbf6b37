//! The error on data that the fit has not seen, fold by fold, for the model and for what it is compared with.

use crate::account;
use crate::base::Structure;
use crate::bristle;
use crate::condition::{Conditioned, Plan};
use crate::consistent::{self, Consistent};
use crate::evaluate::{Score, Tally, Which, training_scale};
use crate::fit::{FitSettings, Solution, fit, predict};
use crate::options::{Method, Options};
use crate::paper::{self, ErrorTable, PaperModels, PaperResult};
use crate::rows::Rows;
use crate::split::{Fold, Holdout, Span, TimeRange, folds, select};
use lacuna_interfaces::BadInput;
use lacuna_physics::RigidBody;
use nalgebra::DVector;

/// A joint that stands for more than this share of the rows makes the standstill trap worth showing.
const STANDS: f64 = 0.05;

/// The rows of the final fit and the folds of the held-out error.
pub(crate) struct Split {
    pub(crate) train: Vec<bool>,
    pub(crate) folds: Vec<Fold>,
    pub(crate) name: String,
    pub(crate) train_ranges: Vec<Span>,
    pub(crate) test_ranges: Vec<Span>,
}

impl Split {
    pub(crate) fn of(
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

/// What every fit of one identification shares.
pub(crate) struct Context<'a> {
    pub(crate) options: &'a Options,
    pub(crate) body: &'a dyn RigidBody,
    pub(crate) structure: &'a Structure,
    pub(crate) conditioned: &'a [Conditioned],
    /// Rows with the sign of the velocity as Coulomb column.
    pub(crate) rows: &'a Rows,
    pub(crate) names: &'a [String],
}

/// Everything fitted on one set of training rows.
pub(crate) struct Fitted {
    /// Rows with the Coulomb columns that these training rows prefer.
    pub(crate) rows: Rows,
    /// Their widths.
    pub(crate) bristle_rad: Vec<Option<f64>>,
    /// The pooled fit.
    pub(crate) solution: Solution,
    /// The constrained fit, if asked for.
    pub(crate) consistent: Option<Consistent>,
    /// The paper's models, if asked for.
    pub(crate) paper: Option<(PaperModels, PaperResult)>,
}

impl Fitted {
    /// The parameters of the method that was asked for.
    pub(crate) fn beta(&self) -> &DVector<f64> {
        match (&self.paper, &self.consistent) {
            (Some((models, _)), _) => &models.with_friction,
            (None, Some(c)) => &c.beta,
            (None, None) => &self.solution.beta,
        }
    }
}

impl Context<'_> {
    /// Fits on the rows where `train` is true: bristles by a first, plain fit, then everything else.
    pub(crate) fn fit(&self, train: &[bool]) -> Result<Fitted, BadInput> {
        let settings = FitSettings { robust: self.options.robust, standstill: false };
        let mut rows = self.rows.clone();
        let mut bristle_rad = vec![None; rows.joints.len()];
        if self.options.conditioning.bristle {
            let first = fit(self.structure, &rows, train, FitSettings { robust: false, ..settings })?;
            bristle_rad = bristle::choose(self.structure, self.conditioned, &mut rows, train, &first)?;
        }
        let solution = fit(self.structure, &rows, train, settings)?;
        let constrain = || consistent::fit(self.body, self.structure, &solution);
        let consistent = if self.options.consistent { Some(constrain()?) } else { None };
        let paper = match self.options.method {
            // The paper knows no bristles.
            Method::Paper => Some(paper::fit(self.structure, self.rows, train, self.names)?),
            Method::Pooled => None,
        };
        Ok(Fitted { rows, bristle_rad, solution, consistent, paper })
    }

    /// The fit with standing joints, for the standstill trap.
    fn fit_at_rest(&self, fitted: &Fitted, train: &[bool]) -> Result<DVector<f64>, BadInput> {
        let settings = FitSettings { robust: self.options.robust, standstill: true };
        Ok(fit(self.structure, &fitted.rows, train, settings)?.beta)
    }
}

/// Held-out figures and curves.
pub(crate) struct Held {
    pub(crate) score: Score,
    pub(crate) folds: Vec<f64>,
    pub(crate) nominal: Option<f64>,
    pub(crate) with_standstill: Option<f64>,
    /// Held-out error of the free fit, if the model is a constrained one.
    pub(crate) free: Option<f64>,
    /// Model torque per joint and row: of the fold that holds the row out, else of the final fit.
    pub(crate) model: Vec<Vec<f64>>,
    pub(crate) held_out: Vec<bool>,
    pub(crate) table1: Vec<ErrorTable>,
    pub(crate) table1_moving: Vec<ErrorTable>,
}

/// Sums over the test rows of all folds.
#[derive(Default)]
struct Tallies {
    model: Tally,
    nominal: Tally,
    standing: Tally,
    free: Tally,
    table: [Tally; 4],
    table_moving: [Tally; 4],
}

/// Evaluates every fold's fit on its test rows.
pub(crate) fn hold_out(context: &Context<'_>, split: &Split, last: &Fitted) -> Result<Held, BadInput> {
    let (structure, rows) = (context.structure, context.rows);
    let n = rows.joints.len();
    let mut model: Vec<Vec<f64>> = (0..n).map(|j| predict(structure, &last.rows, last.beta(), j)).collect();
    let mut held_out = vec![false; rows.len()];
    let mut sums = Tallies::default();
    let mut folds = Vec::new();
    for fold in &split.folds {
        let own;
        let fitted = if fold.train == split.train {
            last
        } else {
            own = context.fit(&fold.train)?;
            &own
        };
        let alone = add_fold(context, fold, fitted, &mut sums)?;
        folds.extend(alone.score().map(|s| s.relative_error));
        for (j, model) in model.iter_mut().enumerate() {
            let predicted = predict(structure, &fitted.rows, fitted.beta(), j);
            for k in (0..rows.len()).filter(|&k| fold.test[k]) {
                model[k] = predicted[k];
                held_out[k] = true;
            }
        }
    }
    let score = sums.model.score().ok_or_else(|| {
        BadInput::new("found no moving joint in the test rows; expected motion there (or a moving speed of 0)")
    })?;
    let relative = |t: &Tally| t.score().map(|s| s.relative_error);
    let has_masses = structure.base.iter().any(|b| b.nominal != 0.0);
    let names = ["M_KH", "M_Id", "M_Id+F", "pooled"];
    Ok(Held {
        score,
        folds,
        nominal: relative(&sums.nominal).filter(|_| has_masses),
        with_standstill: relative(&sums.standing),
        free: relative(&sums.free),
        model,
        held_out,
        table1: account::error_tables(&names, &sums.table),
        table1_moving: account::error_tables(&names, &sums.table_moving),
    })
}

/// Adds one fold's test rows to the sums; returns those of the model alone.
fn add_fold(context: &Context<'_>, fold: &Fold, fitted: &Fitted, sums: &mut Tallies) -> Result<Tally, BadInput> {
    let structure = context.structure;
    let rows = &fitted.rows;
    let nominal = DVector::from_iterator(structure.base.len(), structure.base.iter().map(|b| b.nominal));
    let rested = if stands(rows) { Some(context.fit_at_rest(fitted, &fold.train)?) } else { None };
    let scale = training_scale(rows, &fold.train);
    let mut alone = Tally::default();
    for j in 0..rows.joints.len() {
        let add = |to: &mut Tally, beta: &DVector<f64>, which: Which| {
            to.add(rows, j, &predict(structure, rows, beta, j), &fold.test, which, scale[j]);
        };
        add(&mut sums.model, fitted.beta(), Which::Counted);
        add(&mut alone, fitted.beta(), Which::Counted);
        add(&mut sums.nominal, &nominal, Which::Counted);
        if fitted.consistent.is_some() {
            add(&mut sums.free, &fitted.solution.beta, Which::Counted);
        }
        if let Some(rested) = &rested {
            add(&mut sums.standing, rested, Which::Usable);
        }
        if let Some((p, _)) = &fitted.paper {
            let models = [&p.nominal, &p.identified, &p.with_friction, &fitted.solution.beta];
            for (i, beta) in models.into_iter().enumerate() {
                // The paper's models have the sign of the velocity, as the stages that run them do.
                let own = if i < 3 { context.rows } else { rows };
                let predicted = predict(structure, own, beta, j);
                sums.table[i].add(own, j, &predicted, &fold.test, Which::Usable, scale[j]);
                sums.table_moving[i].add(own, j, &predicted, &fold.test, Which::Counted, scale[j]);
            }
        }
    }
    Ok(alone)
}

/// Whether a joint stands still often enough to matter.
fn stands(rows: &Rows) -> bool {
    rows.joints.iter().any(|j| {
        let idle = j.usable.iter().zip(&j.counted).filter(|(u, c)| **u && !**c).count();
        idle as f64 > STANDS * rows.len() as f64
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
