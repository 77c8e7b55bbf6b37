//! The error on data that the fit has not seen, fold by fold, for the model and for what it is compared with.

use crate::base::Structure;
use crate::consistent::{self, Consistent};
use crate::delay::DelayEstimate;
use crate::evaluate::{Score, Tally, Which};
use crate::fit::draft::{Data, Draft, chosen};
use crate::fit::normal::Choice;
use crate::fit::robust::Store;
use crate::fit::{InstrumentCheck, Solution, fit_all};
use crate::forward::Tested;
use crate::layout::{Chosen, Layout};
use crate::options::{Method, Options};
use crate::paper::{self, ErrorTable, PaperModels, PaperResult};
use crate::paper_tables::PaperTables;
use crate::split::{Fold, Holdout, Span, TimeRange, folds};
use crate::stream::Stream;
use crate::sums::Sums;
use lacuna_estimation::least_squares::Moments;
use lacuna_interfaces::{BadInput, Recording};
use nalgebra::DVector;

/// A joint that stands for more than this share of the rows makes the standstill trap worth showing.
const STANDS: f64 = 0.05;

/// The time of the final fit and the folds of the held-out error.
pub(crate) struct Split {
    pub(crate) train: Vec<Span>,
    pub(crate) folds: Vec<Fold>,
    pub(crate) name: String,
    pub(crate) test: Vec<Span>,
}

impl Split {
    /// `ranges` are training and test ranges, both empty for a holdout of the options.
    pub(crate) fn of(
        stream: &Stream<'_>,
        options: &Options,
        ranges: &(Vec<Span>, Vec<Span>),
    ) -> Result<Self, BadInput> {
        let (train, test) = ranges;
        if !train.is_empty() {
            let fold = Fold { train: train.clone(), test: test.clone() };
            return Ok(Self { train: train.clone(), folds: vec![fold], name: "files".to_owned(), test: test.clone() });
        }
        let recordings = stream.recordings.len();
        let holdout = options.holdout.unwrap_or(if recordings > 1 { Holdout::Recordings } else { Holdout::Halves });
        let name = match holdout {
            Holdout::Recordings => "recordings".to_owned(),
            Holdout::Halves => "halves".to_owned(),
            Holdout::Kfold(n) => format!("kfold={n}"),
        };
        let whole: Vec<Span> = (0..recordings).map(Span::whole).collect();
        let folds = folds(&extent(stream), holdout, 2.0 / stream.plan.band_hz)?;
        Ok(Self { train: whole.clone(), folds, name, test: whole })
    }

    /// Every span of any fold.
    pub(crate) fn spans(&self) -> Vec<Span> {
        let of_folds = self.folds.iter().flat_map(|f| f.train.iter().chain(&f.test));
        self.train.iter().chain(of_folds).cloned().collect()
    }
}

/// Times of the first and the last row of every recording.
fn extent(stream: &Stream<'_>) -> Vec<(f64, f64)> {
    let of = |r: usize| {
        let mut extent = (f64::INFINITY, f64::NEG_INFINITY);
        for (i, s) in stream.prepared[r].stretches.iter().enumerate().filter(|(_, s)| s.rows > 0) {
            extent = (extent.0.min(stream.time_s(r, i, 0)), extent.1.max(stream.time_s(r, i, s.rows - 1)));
        }
        extent
    };
    (0..stream.prepared.len()).map(of).collect()
}

/// What every fit of one identification shares.
pub(crate) struct Context<'a> {
    pub(crate) options: &'a Options,
    pub(crate) data: Data<'a>,
    pub(crate) store: &'a Store,
    pub(crate) names: &'a [String],
}

/// Everything fitted on one set of training spans.
pub(crate) struct Fitted {
    /// Bristle of every joint that these spans prefer.
    pub(crate) bristle: Vec<Option<usize>>,
    /// Delay of the torque over these spans.
    pub(crate) delay: Option<DelayEstimate>,
    /// Delay that was undone by interpolation [s].
    pub(crate) shift_s: f64,
    /// The pooled fit.
    pub(crate) solution: Solution,
    /// Least squares against instruments, where they were made.
    pub(crate) instruments: Option<InstrumentCheck>,
    /// The same with standing joints fitted too, where joints stand.
    at_rest: Option<DVector<f64>>,
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

    /// Columns of joint `j` in a recording.
    pub(crate) fn chosen(&self, stream: &Stream<'_>, recording: usize, j: usize) -> Chosen {
        // The paper's models have the sign of the velocity, as the stages that run them do.
        let bristle = if self.paper.is_some() { None } else { self.bristle[j] };
        chosen(stream, recording, bristle, self.shift_s)
    }
}

impl Context<'_> {
    /// Fits every set of training spans.
    fn fit(&self, trains: &[&[Span]]) -> Result<Vec<Fitted>, BadInput> {
        let Self { options, data, .. } = *self;
        let stands = self.stands();
        let finish = |draft: &Draft, solution: Solution, instruments: Option<InstrumentCheck>| {
            let at_rest = if stands {
                let choice = Choice {
                    excited: solution.excited.clone(),
                    unexcited: Vec::new(),
                    lossy: false,
                    fixed: fixed(&solution),
                };
                // Columns that only QR tells apart have no such comparison.
                draft.at_rest(data).solve(&choice).ok()
            } else {
                None
            };
            let constrain = || consistent::fit(data.stream.body, data.stream.structure, &solution);
            let consistent = if options.consistent { Some(constrain()?) } else { None };
            Ok(Fitted {
                bristle: draft.bristle.clone(),
                delay: draft.delay,
                shift_s: draft.shift_s,
                solution,
                instruments,
                at_rest,
                consistent,
                paper: None,
            })
        };
        let mut all = fit_all(data, self.store, trains, options, finish)?;
        if options.method == Method::Paper {
            for (fitted, train) in all.iter_mut().zip(trains) {
                let cells = data.sums.cells.within(train);
                fitted.paper = Some(paper::fit(data, &cells, fitted.shift_s, self.names)?);
            }
        }
        Ok(all)
    }

    /// Whether a joint stands still often enough to matter.
    fn stands(&self) -> bool {
        self.data.sums.survey.iter().any(|s| (s.usable - s.counted) as f64 > STANDS * s.rows as f64)
    }
}

/// Values of the columns that were not fitted; 0 for the others.
fn fixed(solution: &Solution) -> Vec<f64> {
    let mut fixed = vec![0.0; solution.beta.len()];
    solution.unexcited.iter().for_each(|u| fixed[u.base] = solution.beta[u.base]);
    fixed
}

/// Held-out figures, and the fits behind them.
pub(crate) struct Held {
    pub(crate) score: Score,
    pub(crate) folds: Vec<f64>,
    pub(crate) nominal: Option<f64>,
    pub(crate) with_standstill: Option<f64>,
    /// Held-out error of the free fit, if the model is a constrained one.
    pub(crate) free: Option<f64>,
    /// The fit on all training spans.
    pub(crate) last: Fitted,
    /// The fits of folds with other training spans.
    others: Vec<Fitted>,
    /// Index into `others` per fold; `None`: `last`.
    of_fold: Vec<Option<usize>>,
    /// Fold that holds a cell out.
    held_by: Vec<Option<usize>>,
    pub(crate) table1: Vec<ErrorTable>,
    pub(crate) table1_moving: Vec<ErrorTable>,
}

impl Held {
    /// The fit of a fold.
    fn fold(&self, fold: usize) -> &Fitted {
        self.of_fold[fold].map_or(&self.last, |i| &self.others[i])
    }

    /// The fit that predicts a cell, and whether it has not seen it.
    pub(crate) fn of_cell(&self, cell: usize) -> (&Fitted, bool) {
        self.held_by[cell].map_or((&self.last, false), |fold| (self.fold(fold), true))
    }

    /// The fit of every fold, with what it has not seen.
    pub(crate) fn tested<'a>(&'a self, split: &'a Split) -> Vec<Tested<'a>> {
        let of = |(f, fold): (usize, &'a Fold)| {
            let fitted = self.fold(f);
            Tested { spans: &fold.test, beta: fitted.beta(), shift_s: fitted.shift_s }
        };
        split.folds.iter().enumerate().map(of).collect()
    }

    /// Delay undone in every fold [s].
    pub(crate) fn shifts_s(&self) -> Vec<f64> {
        (0..self.of_fold.len()).map(|f| self.fold(f).shift_s).collect()
    }
}

/// Sums over the test rows of all folds.
#[derive(Default)]
struct Tallies {
    model: Tally,
    nominal: Tally,
    standing: Tally,
    free: Tally,
    paper: PaperTables,
}

/// Fits all training spans and every fold's, and evaluates the folds' fits on their test rows.
pub(crate) fn hold_out(context: &Context<'_>, split: &Split) -> Result<Held, BadInput> {
    let structure = context.data.stream.structure;
    let mut trains: Vec<&[Span]> = vec![&split.train];
    let mut of_fold = Vec::new();
    for fold in &split.folds {
        of_fold.push((fold.train != split.train).then(|| trains.len() - 1));
        if fold.train != split.train {
            trains.push(&fold.train);
        }
    }
    let mut others = context.fit(&trains)?;
    let last = others.remove(0);
    let mut sums = Tallies::default();
    let mut errors = Vec::new();
    let mut held_by = vec![None; context.data.sums.cells.list.len()];
    for (f, fold) in split.folds.iter().enumerate() {
        let fitted = of_fold[f].map_or(&last, |i: usize| &others[i]);
        let test = context.data.sums.cells.within(&fold.test);
        held_by.iter_mut().zip(&test).filter(|(_, t)| **t).for_each(|(h, _)| *h = Some(f));
        let alone = add_fold(context, fold, &test, fitted, &mut sums);
        errors.extend(alone.score().map(|s| s.relative_error));
    }
    let score = sums.model.score().ok_or_else(|| {
        BadInput::new("found no moving joint in the test rows; expected motion there (or a moving speed of 0)")
    })?;
    let relative = |t: &Tally| t.score().map(|s| s.relative_error);
    let has_masses = structure.base.iter().any(|b| b.nominal != 0.0);
    let (table1, table1_moving) = sums.paper.tables();
    Ok(Held {
        score,
        folds: errors,
        nominal: relative(&sums.nominal).filter(|_| has_masses),
        with_standstill: relative(&sums.standing),
        free: relative(&sums.free),
        last,
        others,
        of_fold,
        held_by,
        table1,
        table1_moving,
    })
}

/// The robot file's own base parameters: no friction.
pub(crate) fn nominal_beta(structure: &Structure) -> DVector<f64> {
    DVector::from_iterator(structure.base.len(), structure.base.iter().map(|b| b.nominal))
}

/// Adds one fold's test rows to the sums; returns those of the model alone.
fn add_fold(context: &Context<'_>, fold: &Fold, test: &[bool], fitted: &Fitted, sums: &mut Tallies) -> Tally {
    let Data { stream, sums: data } = context.data;
    let nominal = nominal_beta(stream.structure);
    let train = data.cells.within(&fold.train);
    let mut alone = Tally::default();
    for j in 0..stream.layout.len() {
        let scale = training_scale(context.data, &train, j);
        let columns = |r: usize| fitted.chosen(stream, r, j);
        let of = |beta: &DVector<f64>, which: Which| residuals(context.data, test, &columns, j, beta, which);
        let own = of(fitted.beta(), Which::Counted);
        sums.model.add_sums(j, own, scale);
        alone.add_sums(j, own, scale);
        sums.nominal.add_sums(j, of(&nominal, Which::Counted), scale);
        if fitted.consistent.is_some() {
            sums.free.add_sums(j, of(&fitted.solution.beta, Which::Counted), scale);
        }
        if let Some(at_rest) = &fitted.at_rest {
            sums.standing.add_sums(j, of(at_rest, Which::Usable), scale);
        }
    }
    sums.paper.add(context.data, test, fitted);
    alone
}

/// Σ1, Σe, Σe² and Στ² over the rows of a joint in `test` cells; `columns` chooses them by recording.
pub(crate) fn residuals(
    data: Data<'_>,
    test: &[bool],
    columns: &impl Fn(usize) -> Chosen,
    j: usize,
    beta: &DVector<f64>,
    which: Which,
) -> [f64; 4] {
    let layout = &data.stream.layout[j];
    let mut out = [0.0; 4];
    each_sum(data, test, j, which, |recording, sum| {
        let chosen = columns(recording);
        let (e, y, one) = (chosen.residual(layout, beta.as_slice()), chosen.y(layout), [(layout.one(), 1.0)]);
        let more =
            [Sums::rows_in(layout, sum), sum.product(&e, &one), sum.product(&e, &e).max(0.0), sum.product(&y, &y)];
        out.iter_mut().zip(more).for_each(|(o, m)| *o += m);
    });
    out
}

/// Calls `take` with the recording and every sum over a joint's rows in `cells`.
pub(crate) fn each_sum(data: Data<'_>, cells: &[bool], j: usize, which: Which, mut take: impl FnMut(usize, &Moments)) {
    let own = &data.sums.cells;
    for (c, cell) in own.list.iter().enumerate().filter(|(c, _)| cells[*c]) {
        take(cell.recording, &data.sums.fitted[c][j]);
    }
    let recordings = own.recording_of_piece();
    for (piece, _) in own.pieces_within(cells).iter().enumerate().filter(|(_, inside)| **inside) {
        take(recordings[piece], &data.sums.counted[2 * piece][j]);
        take(recordings[piece], &data.sums.counted[2 * piece + 1][j]);
        if which == Which::Usable {
            take(recordings[piece], &data.sums.standing[piece][j]);
        }
    }
}

/// Standard deviation of a joint's torque over usable training rows; 1 where there is none.
fn training_scale(data: Data<'_>, train: &[bool], j: usize) -> f64 {
    let layout: &Layout = &data.stream.layout[j];
    let (mut rows, mut y, mut yy) = (0.0, 0.0, 0.0);
    let torque = Chosen::plain().y(layout);
    each_sum(data, train, j, Which::Usable, |_, sum| {
        rows += Sums::rows_in(layout, sum);
        y += sum.product(&torque, &[(layout.one(), 1.0)]);
        yy += sum.product(&torque, &torque);
    });
    let sd = ((yy - y * y / f64::max(rows, 1.0)) / f64::max(rows - 1.0, 1.0)).max(0.0).sqrt();
    if sd.is_finite() && sd > 0.0 { sd } else { 1.0 }
}

/// Spans with their file names and finite ends.
pub(crate) fn time_ranges(spans: &[Span], recordings: &[Recording]) -> Vec<TimeRange> {
    spans
        .iter()
        .map(|s| {
            let own = &recordings[s.recording];
            let (first, last) = (own.t_s.first().copied().unwrap_or(0.0), own.t_s.last().copied().unwrap_or(0.0));
            TimeRange { file: own.name.clone(), from_s: s.from_s.max(first), to_s: s.to_s.min(last) }
        })
        .collect()
}
