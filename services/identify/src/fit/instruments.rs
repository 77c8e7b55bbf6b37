//! Instruments against errors in variables (Young 1970; for robots Janot, Vandanjon, Gautier 2014).
//!
//! Encoder noise, differentiated twice, is in the acceleration columns themselves: least squares then shrinks inertias by
//! the noise's share of the column's power. Instruments ζ are columns that move with the truth but not with that noise:
//!
//! ```text
//! ζᵀW(y − X β) = 0
//! ```
//!
//! The motion that stands in for the noise-free one is the measured one, smoothed, or where it is asked for and recordings
//! have the commanded positions, the one that follows from them ([`super::commanded`]), which no encoder has touched. On
//! simulated arms neither is less biased than the other, and the smoothed one is more precise. It needs no command:
//!
//! ```text
//! ζ: X at the motion below a fifth of the band;  white noise in q has power ∝ f⁵ in q̈: a 3000th is left
//! ```
//!
//! (A closed loop simulated under the identified model along that smoothed motion, with a controller that knows the model,
//! follows it exactly: it would be the same instrument.) What does not depend on acceleration or velocity (Coulomb friction, offset) is its own
//! instrument. Whether it matters is what Hausman (1978) asks: is the difference of the two estimates larger than its own
//! delete-one-block error allows?

use super::commanded::Loops;
use super::draft::{Data, Draft};
use super::normal::covariance;
use super::robust::beyond;
use super::{Solution, student_975};
use crate::columns::Term;
use crate::condition::{Plan, Stretch};
use crate::layout::Layout;
use crate::stream::{Class, Part, PartRows, Stream};
use lacuna_estimation::filter::noise_sd;
use lacuna_estimation::least_squares::{CrossMoments, GRAM_CONDITION_LIMIT};
use lacuna_estimation::stats::{normal_quantile, rms};
use lacuna_interfaces::BadInput;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// When to use instruments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Instruments {
    /// Where encoder noise has a share in the accelerations and the estimates differ by more than chance.
    #[default]
    Auto,
    /// Always.
    On,
    /// Always, from the motion that follows from the command (`columns.reference` of the robot file).
    Command,
    /// Least squares.
    Off,
}

impl std::str::FromStr for Instruments {
    type Err = BadInput;

    fn from_str(text: &str) -> Result<Self, BadInput> {
        match text {
            "auto" => Ok(Self::Auto),
            "on" => Ok(Self::On),
            "command" => Ok(Self::Command),
            "off" => Ok(Self::Off),
            _ => Err(BadInput::new(format!("instruments: found \"{text}\"; expected auto, on, command or off"))),
        }
    }
}

/// Which motion instruments come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum InstrumentMotion {
    /// The measured one, smoothed.
    Smoothed,
    /// The one that follows from the command.
    Resimulated,
}

/// Least squares against instruments.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InstrumentCheck {
    /// Whether the model has the instruments' estimates.
    pub used: bool,
    /// Which motion the instruments come from.
    pub motion: InstrumentMotion,
    /// Low-pass of that motion [Hz].
    pub band_hz: f64,
    /// Least share of a joint's velocity that the command explains, by power, below a fifth of the band; absent where the
    /// motion is the measured one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub explained: Option<f64>,
    /// Parameter whose two estimates differ most, in standard errors of the difference.
    pub symbol: String,
    /// Its least-squares estimate.
    pub least_squares: f64,
    /// Its estimate by instruments.
    pub instruments: f64,
    /// Difference over its standard error.
    pub statistic: f64,
    /// What the largest of so many differences stays below by chance in 95 % of cases.
    pub threshold: f64,
}

/// Instruments' band over the band of the fit.
pub(super) const BAND_SHARE: f64 = 0.2;
/// Share of encoder noise in a joint's acceleration, by power, from which on instruments are made: an inertia that is a
/// 500th too small.
pub(super) const NOISE_SHARE: f64 = 2e-3;
/// Parts that are looked at for encoder noise.
const PROBES: usize = 6;

/// Largest share of encoder noise in a joint's acceleration within the band, by power.
///
/// # Errors
/// As [`crate::stream::Stream::around`].
pub(crate) fn noise_share(data: Data<'_>) -> Result<f64, BadInput> {
    let stream = data.stream;
    let plan = stream.plan;
    let parts: Vec<&Part> = stream.probes(PROBES);
    let found: Vec<Vec<(f64, f64)>> = parts
        .par_iter()
        .map(|part| {
            let (mut stretch, at) = stream.around(part, plan, plan.band_hz)?;
            let rate = stream.prepared[part.recording].sample_rate_hz;
            let omega = std::f64::consts::TAU * plan.band_hz;
            // White noise σ per sample: ∫ ω⁴ S df from 0 to the band, S = 2σ²/rate.
            let gain = omega.powi(4) * 2.0 * plan.band_hz / (5.0 * rate);
            let raw = stream.raw(part);
            let mut columns = std::mem::take(&mut stretch.qdd_rad_s2);
            stretch.band(&mut columns.iter_mut().map(Vec::as_mut_slice).collect::<Vec<_>>())?;
            Ok(columns
                .iter()
                .zip(raw)
                .map(|(qdd, q)| {
                    let own: Vec<f64> = at.iter().map(|&k| qdd[k]).collect();
                    let sd = noise_sd(q).unwrap_or(0.0);
                    (gain * sd * sd, rms(&own).powi(2))
                })
                .collect())
        })
        .collect::<Result<_, BadInput>>()?;
    let share = |j: usize| {
        let (noise, all) = found.iter().fold((0.0, 0.0), |(n, a), part| (n + part[j].0, a + part[j].1));
        if all > 0.0 { noise / all } else { 0.0 }
    };
    Ok((0..stream.layout.len()).map(share).fold(0.0, f64::max))
}

/// The motion of the instruments.
#[derive(Debug)]
pub(crate) enum Motion {
    /// The measured one below this frequency [Hz].
    Smoothed { band_hz: f64 },
    /// The one that follows from the command.
    Resimulated(Loops),
}

impl Motion {
    /// From the command where that was asked for, else smoothed.
    ///
    /// # Errors
    /// [`BadInput`] where the command is asked for and recordings have none, or it explains too little of the motion.
    pub(crate) fn choose(data: Data<'_>, instruments: Instruments) -> Result<Self, BadInput> {
        match instruments {
            Instruments::Command => Ok(Self::Resimulated(Loops::find(data)?)),
            _ => Ok(Self::Smoothed { band_hz: BAND_SHARE * data.stream.plan.band_hz }),
        }
    }

    /// That motion over a part, with directions as `measured`.
    ///
    /// # Errors
    /// As [`crate::stream::Stream::around`].
    pub(crate) fn of(&self, stream: &Stream<'_>, part: &Part, measured: &Stretch) -> Result<Stretch, BadInput> {
        let plan = Plan { bristle: false, ..stream.plan.clone() };
        match self {
            Self::Resimulated(loops) => loops.motion(stream, part, &plan, measured),
            Self::Smoothed { band_hz } => {
                let plan = Plan { position_band_hz: *band_hz, ..plan };
                let mut narrow = stream.around(part, &plan, band_hz.min(plan.band_hz))?.0;
                // Where the friction changes sign is no matter of acceleration noise.
                narrow.sign.clone_from(&measured.sign);
                Ok(narrow)
            }
        }
    }

    fn kind(&self, plan: &Plan) -> (InstrumentMotion, f64, Option<f64>) {
        match self {
            Self::Smoothed { band_hz } => (InstrumentMotion::Smoothed, *band_hz, None),
            Self::Resimulated(l) => (InstrumentMotion::Resimulated, plan.position_band_hz, Some(l.explained)),
        }
    }
}

/// Cross products of instruments and rows: `[cell][joint]`, and per draft what bounded influence takes off.
pub(crate) struct InstrumentSums {
    kind: (InstrumentMotion, f64, Option<f64>),
    cells: Vec<Vec<CrossMoments>>,
    lost: BTreeMap<(usize, usize, usize), CrossMoments>,
}

/// What a part adds: (cell, joint) and (draft, cell, joint).
type Share = (BTreeMap<(usize, usize), CrossMoments>, BTreeMap<(usize, usize, usize), CrossMoments>);

impl InstrumentSums {
    /// A pass over all rows.
    ///
    /// # Errors
    /// As [`crate::stream::Stream::rows_of`].
    pub(crate) fn new(data: Data<'_>, drafts: &[Draft], motion: &Motion) -> Result<Self, BadInput> {
        let layout = &data.stream.layout;
        let empty = || layout.iter().map(|l| CrossMoments::new(l.width(), l.len())).collect::<Vec<_>>();
        let kind = motion.kind(data.stream.plan);
        let mut out = Self { kind, cells: vec![empty(); data.sums.cells.list.len()], lost: BTreeMap::new() };
        let make = |_: usize, part: &Part| {
            let rows = data.stream.rows_of(part, Some(motion))?;
            share(data, &rows, drafts)
        };
        data.stream.pass(make, |(sums, lost)| {
            sums.into_iter().for_each(|((c, j), sum)| out.cells[c][j].merge(&sum));
            for (key, sum) in lost {
                match out.lost.get_mut(&key) {
                    Some(to) => to.merge(&sum),
                    None => {
                        out.lost.insert(key, sum);
                    }
                }
            }
            Ok(())
        })?;
        Ok(out)
    }

    /// ζᵀW\[X y\] of a cell over the base columns, p × (p + 1).
    fn cell(&self, data: Data<'_>, d: usize, draft: &Draft, cell: usize) -> DMatrix<f64> {
        let structure = data.stream.structure;
        let p = structure.base.len();
        let mut out = DMatrix::zeros(p, p + 1);
        for (j, layout) in data.stream.layout.iter().enumerate() {
            let weight = 1.0 / (draft.sigma[j] * draft.sigma[j]);
            let chosen = draft.chosen(data, cell, j);
            let mixture = chosen.pooled(layout, p);
            let lost = draft.lost.get(&(cell, j));
            let lost_z = self.lost.get(&(d, cell, j));
            for (slot, &b) in layout.active.iter().enumerate() {
                let mut add = |column: usize, value: f64| out[(b, column)] += weight * value;
                if own_instrument(structure.columns[structure.base[b].column].term) {
                    let place = layout.place(slot, chosen.bristle);
                    let own = data.sums.fitted[cell][j].products();
                    mixture.iter().for_each(|&(i, column, f)| add(column, f * own[(place, i)]));
                    if let Some(lost) = lost {
                        layout.active.iter().enumerate().for_each(|(s, &c)| add(c, -lost.products()[(slot, s)]));
                        add(p, -lost.products()[(slot, layout.width())]);
                    }
                } else {
                    let cross = self.cells[cell][j].products();
                    mixture.iter().for_each(|&(i, column, f)| add(column, f * cross[(slot, i)]));
                    if let Some(lost) = lost_z {
                        layout.active.iter().enumerate().for_each(|(s, &c)| add(c, -lost.products()[(slot, s)]));
                        add(p, -lost.products()[(slot, layout.width())]);
                    }
                }
            }
        }
        out
    }

    /// The estimate by instruments of the draft number `d`, whose least-squares fit is `solution`, and the check; `None`
    /// where the instruments do not determine it.
    pub(crate) fn solve(
        &self,
        data: Data<'_>,
        d: usize,
        draft: &Draft,
        solution: &Solution,
    ) -> Option<(Solution, InstrumentCheck)> {
        // Square equations of instruments lose digits as normal equations do.
        if solution.condition > GRAM_CONDITION_LIMIT {
            return None;
        }
        let p = solution.beta.len();
        let mut blocks: BTreeMap<usize, (DMatrix<f64>, DMatrix<f64>)> = BTreeMap::new();
        for cell in draft.own_cells() {
            let own = blocks
                .entry(data.sums.cells.list[cell].block)
                .or_insert_with(|| (DMatrix::zeros(p, p + 1), DMatrix::zeros(p, p + 1)));
            own.0 += self.cell(data, d, draft, cell);
            own.1 += draft.cell(data, cell, p).xtx_xty();
        }
        blocks.retain(|_, (z, x)| z.amax() > 0.0 && x.amax() > 0.0);
        let zero = || DMatrix::zeros(p, p + 1);
        let (z, x) = blocks.values().fold((zero(), zero()), |(z, x), (bz, bx)| (z + bz, x + bx));
        let beta = solve(&z, solution)?;
        let pairs: Vec<(DVector<f64>, DVector<f64>)> = blocks
            .values()
            .collect::<Vec<_>>()
            .par_iter()
            .filter_map(|(bz, bx)| Some((solve(&(&z - bz), solution)?, solve(&(&x - bx), solution)?)))
            .collect();
        let own: Vec<DVector<f64>> = pairs.iter().map(|(z, _)| z.clone()).collect();
        let apart: Vec<DVector<f64>> = pairs.iter().map(|(z, x)| z - x).collect();
        let (own, count) = covariance(&own, p);
        let (apart, _) = covariance(&apart, p);
        if count < 3 {
            return None;
        }
        let structure = data.stream.structure;
        let symbol = |b: usize| structure.columns[structure.base[b].column].symbol.clone();
        let moving = |b: &usize| !own_instrument(structure.columns[structure.base[*b].column].term);
        let statistic = |b: usize| (beta[b] - solution.beta[b]) / apart[(b, b)].max(f64::MIN_POSITIVE).sqrt();
        let tested: Vec<usize> = solution.excited.iter().copied().filter(moving).collect();
        let worst = tested.iter().copied().max_by(|&a, &b| statistic(a).abs().total_cmp(&statistic(b).abs()))?;
        // Šidák's bound for the largest of so many, widened as Student's t is for so few blocks.
        let tail = 1.0 - 0.95f64.powf(1.0 / tested.len() as f64);
        let widened = student_975(count - 1) / normal_quantile(0.975);
        let check = InstrumentCheck {
            used: false,
            motion: self.kind.0,
            band_hz: self.kind.1,
            explained: self.kind.2,
            symbol: symbol(worst),
            least_squares: solution.beta[worst],
            instruments: beta[worst],
            statistic: statistic(worst),
            threshold: normal_quantile(1.0 - 0.5 * tail) * widened,
        };
        Some((Solution { beta, covariance: own, blocks: count, ..solution.clone() }, check))
    }
}

/// Coulomb friction and offsets do not depend on what the noise is in.
fn own_instrument(term: Term) -> bool {
    matches!(term, Term::Coulomb(_) | Term::Offset(_))
}

/// β from square equations \[A b\] of the columns that `solution` fits; the others keep their values.
fn solve(equations: &DMatrix<f64>, solution: &Solution) -> Option<DVector<f64>> {
    let (p, excited) = (solution.beta.len(), &solution.excited);
    let mut fixed = solution.beta.clone();
    excited.iter().for_each(|&b| fixed[b] = 0.0);
    let right = equations.column(p) - equations.columns(0, p) * &fixed;
    let xtx = solution.normal.xtx();
    let scale = DVector::from_iterator(excited.len(), excited.iter().map(|&b| 1.0 / xtx[(b, b)].sqrt()));
    let left = DMatrix::from_fn(excited.len(), excited.len(), |i, k| {
        equations[(excited[i], excited[k])] * scale[i] * scale[k]
    });
    let rhs = DVector::from_fn(excited.len(), |i, _| right[excited[i]] * scale[i]);
    let solved = left.lu().solve(&rhs)?.component_mul(&scale);
    let mut beta = fixed;
    excited.iter().zip(solved.iter()).for_each(|(&b, v)| beta[b] = *v);
    beta.iter().all(|v| v.is_finite()).then_some(beta)
}

fn share(data: Data<'_>, rows: &PartRows, drafts: &[Draft]) -> Result<Share, BadInput> {
    let mut out = Share::default();
    let of_part = data.sums.cells.of_part(&rows.part);
    for (j, (layout, joint)) in data.stream.layout.iter().zip(&rows.joints).enumerate() {
        let (m, w) = (layout.len(), layout.width());
        if w == 0 {
            continue;
        }
        let (mut z, mut zeta) = (Vec::new(), Vec::new());
        for (cell, range) in &of_part {
            z.clear();
            zeta.clear();
            for k in range.clone().filter(|&k| joint.class[k] == Class::Fitted) {
                let row = &joint.z[k * (m + w)..(k + 1) * (m + w)];
                z.extend_from_slice(&row[..m]);
                zeta.extend_from_slice(&row[m..]);
            }
            if z.is_empty() {
                continue;
            }
            out.0.entry((*cell, j)).or_insert_with(|| CrossMoments::new(w, m)).add_rows(&zeta, &z)?;
            for (d, draft) in drafts.iter().enumerate().filter(|(_, d)| d.cells[*cell]) {
                let chosen = draft.chosen_in(data, rows.part.recording, j);
                beyond(layout, &chosen, draft, j, z.chunks_exact(m), |k, less, row| {
                    out.1.entry((d, *cell, j)).or_insert_with(|| CrossMoments::new(w, w + 1)).add_row(
                        less,
                        &zeta[k * w..(k + 1) * w],
                        row,
                    );
                });
            }
        }
    }
    Ok(out)
}

/// Bytes that a draft's losses take per cell.
pub(crate) fn bytes(layout: &[Layout]) -> usize {
    layout.iter().map(|l| 8 * l.width() * (l.width() + 1)).sum()
}
