//! What a user should know before trusting the model, in words, each with the number that shows it.

use crate::base::Structure;
use crate::columns::Term;
use crate::condition::{Plan, Prepared};
use crate::delay::DelayEstimate;
use crate::evaluate::Score;
use crate::fit::{InstrumentCheck, Solution, Why};
use crate::forward::Forward;
use crate::outcome::Consistency;
use crate::sums::Survey;
use lacuna_interfaces::RobotFile;
use lacuna_report::number::significant;

/// Everything that warnings look at.
pub(crate) struct Findings<'a> {
    pub(crate) robot: &'a RobotFile,
    pub(crate) structure: &'a Structure,
    pub(crate) recordings: &'a [Prepared],
    pub(crate) survey: &'a [Survey],
    /// Time that the rows cover [s].
    pub(crate) seconds: f64,
    /// Least and largest position per joint over all recordings [rad].
    pub(crate) positions: Vec<(f64, f64)>,
    pub(crate) solution: &'a Solution,
    pub(crate) plan: &'a Plan,
    pub(crate) held_out: &'a Score,
    pub(crate) with_standstill: Option<f64>,
    /// Error of every recording held out in turn; empty for another split.
    pub(crate) by_recording: &'a [f64],
    pub(crate) forward: Option<&'a Forward>,
    pub(crate) delay: Option<DelayEstimate>,
    pub(crate) instruments: Option<&'a InstrumentCheck>,
    pub(crate) consistency: Option<Consistency>,
}

/// Least time in motion that supports intervals [s].
const SHORT_S: f64 = 10.0;
/// Fewest blocks of time for intervals that deserve the name.
const FEW_BLOCKS: usize = 20;

pub(crate) fn all(f: &Findings<'_>) -> Vec<String> {
    let mut out = Vec::new();
    amount(f, &mut out);
    excitation(f, &mut out);
    rank(f, &mut out);
    saturation(f, &mut out);
    units(f, &mut out);
    degrees(f, &mut out);
    standstill(f, &mut out);
    timing(f, &mut out);
    encoder(f, &mut out);
    quality(f, &mut out);
    disagreement(f, &mut out);
    simulated(f, &mut out);
    out
}

fn amount(f: &Findings<'_>, out: &mut Vec<String>) {
    let seconds = f.seconds;
    if f.recordings.len() < 2 {
        out.push(format!(
            "too few recordings: found 1 ({seconds:.1} s); what differs from day to day is not in it, and the intervals do \
             not cover it"
        ));
    }
    let share = |s: &Survey| s.fitted as f64 / s.rows.max(1) as f64;
    let moving_s = f.seconds * f.survey.iter().map(share).fold(1.0, f64::min);
    if moving_s < SHORT_S {
        out.push(format!(
            "little data: the joint that moves least gives {moving_s:.1} s in motion; expected {SHORT_S} s or more"
        ));
    }
    if f.solution.blocks < FEW_BLOCKS {
        out.push(format!(
            "the intervals rest on {} blocks of time; expected {FEW_BLOCKS} or more for intervals that hold",
            f.solution.blocks
        ));
    }
    for r in f.recordings.iter().filter(|r| r.dropped_s > 0.0) {
        out.push(format!(
            "{}: {:.2} s lie in stretches between gaps that are too short to filter",
            r.name, r.dropped_s
        ));
    }
    let uneven: Vec<f64> = f.recordings.iter().filter(|r| r.resampled).map(|r| r.sample_rate_hz).collect();
    if !uneven.is_empty() {
        let (low, high) = uneven.iter().fold((f64::INFINITY, 0.0f64), |(l, h), r| (l.min(*r), h.max(*r)));
        out.push(format!(
            "{} of {} recordings are sampled irregularly; interpolated to their median rate, {low:.1} to {high:.1} Hz",
            uneven.len(),
            f.recordings.len()
        ));
    }
}

fn excitation(f: &Findings<'_>, out: &mut Vec<String>) {
    for (j, joint) in f.survey.iter().enumerate() {
        let (moving, fastest) = (joint.counted, joint.fastest);
        let share = moving as f64 / joint.rows.max(1) as f64;
        if share < 0.05 {
            out.push(format!(
                "joint {} ({}) is hardly excited: it moves faster than {} rad/s in {:.1} % of the time, {fastest:.3} rad/s at most",
                j + 1,
                f.robot.joints[j],
                f.plan.moving_rad_s,
                100.0 * share
            ));
            continue;
        }
        let one_way = joint.forward.min(moving - joint.forward) as f64 / moving.max(1) as f64;
        if one_way < 0.02 && f.plan.moving_rad_s > 0.0 {
            out.push(format!(
                "joint {} ({}) moves in one direction only ({:.1} % the other way): its Coulomb friction and its offset are one number",
                j + 1,
                f.robot.joints[j],
                100.0 * one_way
            ));
        }
    }
}

fn rank(f: &Findings<'_>, out: &mut Vec<String>) {
    let s = f.structure;
    let symbol = |b: usize| s.columns[s.base[b].column].symbol.as_str();
    let unexcited = &f.solution.unexcited;
    let zero: Vec<&str> = unexcited.iter().filter(|u| u.why == Why::Zero).map(|u| symbol(u.base)).collect();
    let merged: Vec<String> = unexcited
        .iter()
        .filter(|u| matches!(u.why, Why::Dependent | Why::Uncertain(_)))
        .map(|u| {
            let most = u.combination.iter().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
            most.map_or_else(|| symbol(u.base).to_owned(), |m| format!("{} (near {})", symbol(u.base), symbol(m.0)))
        })
        .collect();
    if !zero.is_empty() {
        out.push(format!(
            "rank deficient: {} of {} base parameters are not excited at all: {}",
            zero.len(),
            s.base.len(),
            zero.join(", ")
        ));
    }
    if !merged.is_empty() {
        out.push(format!(
            "collinear columns: these recordings do not tell {} from the rest (condition number {} with, {} without)",
            merged.join(", "),
            significant(f.solution.condition_all, 2),
            significant(f.solution.condition, 2)
        ));
    }
    for j in 0..f.robot.joint_count() {
        out.extend(other_way(f, j));
    }
    for u in unexcited {
        if let Why::Negative(v) = u.why {
            out.push(format!(
                "{} came out negative ({} {}), which no friction is; it is set to 0",
                symbol(u.base),
                significant(v, 3),
                s.columns[s.base[u.base].column].unit
            ));
        }
    }
    if f.solution.condition > 1e3 {
        out.push(format!(
            "ill-conditioned: the condition number of the fit is {}; expected below 1000 (a richer excitation trajectory helps)",
            significant(f.solution.condition, 2)
        ));
    }
}

/// Both friction coefficients of a joint negative: the torque drives the motion where friction brakes it.
fn other_way(f: &Findings<'_>, j: usize) -> Option<String> {
    let s = f.structure;
    let negative = |term: Term| {
        let of = |b: usize| s.columns[s.base[b].column].term == term;
        f.solution.unexcited.iter().find_map(|u| match u.why {
            Why::Negative(v) if of(u.base) => Some(v),
            _ => None,
        })
    };
    let (coulomb, viscous) = (negative(Term::Coulomb(j))?, negative(Term::Viscous(j))?);
    let unit = f.robot.torque_unit.symbol();
    Some(format!(
        "wrong sign? friction of joint {} ({}) drives it, {} {unit} and {} {unit} s/rad: do torque and position count in \
         opposite directions?",
        j + 1,
        f.robot.joints[j],
        significant(coulomb, 3),
        significant(viscous, 3)
    ))
}

fn saturation(f: &Findings<'_>, out: &mut Vec<String>) {
    let unit = f.robot.torque_unit.symbol();
    for r in f.recordings {
        for (j, s) in r.saturation.iter().enumerate() {
            if let Some(s) = s {
                out.push(format!(
                    "{}: the torque of joint {} stays at its limit of {:.4} {unit} in {} samples ({:.1} %): saturated, left out of the fit",
                    r.name,
                    j + 1,
                    s.level,
                    s.samples,
                    100.0 * s.share
                ));
            }
        }
    }
}

/// Torques in another unit than the robot file says: all rigid-body parameters off by one factor, or peaks that the
/// drive's rating does not allow.
fn units(f: &Findings<'_>, out: &mut Vec<String>) {
    let s = f.structure;
    if let Some(factor) = common_factor(s, f.solution)
        && !(0.5..=2.0).contains(&factor)
    {
        let gear = (0..f.robot.joint_count()).find_map(|j| f.robot.drive.gear_ratio.as_ref().and_then(|g| g.get(j)));
        let hint = match gear {
            Some(g) if (factor * g.abs() - 1.0).abs() < 0.3 => format!("; the gear ratio is {g}: a motor-side torque?"),
            _ => "; a current or a motor-side torque called Nm?".to_owned(),
        };
        out.push(format!(
            "wrong unit? the rigid-body parameters are {factor:.3} times what the robot file says, all alike{hint}"
        ));
    } else if let Some((least, most)) = all_off(s, f.solution) {
        out.push(format!(
            "wrong unit? every rigid-body parameter is {} to {} times what the robot file says: a current or a motor-side \
             torque called Nm, or another robot's masses?",
            significant(least, 3),
            significant(most, 3)
        ));
    }
    for (j, joint) in f.survey.iter().enumerate() {
        let peak = joint.peak;
        let rated = f.robot.drive.rated_torque_nm.as_ref().and_then(|r| r.get(j));
        if let Some(rated) = rated
            && (peak > 10.0 * rated || peak < 0.01 * rated)
        {
            out.push(format!(
                "wrong unit? joint {} peaks at {peak:.4} {}; the drive is rated for {rated} Nm",
                j + 1,
                f.robot.torque_unit.symbol()
            ));
        }
    }
}

/// A joint of an arm that turns further than this [rad] without a limit in the robot file: two whole turns.
const TURNS: f64 = 2.0 * std::f64::consts::TAU;
/// How far beyond its limit a joint must be before the unit is in doubt; degrees are 57 times.
const FAR_BEYOND: f64 = 3.0;

/// Positions in degrees called radians: far beyond the joint's limits, or several turns of an arm's joint.
fn degrees(f: &Findings<'_>, out: &mut Vec<String>) {
    let limits = &f.robot.limits;
    let limit = |list: &Option<lacuna_interfaces::robot::PerJoint>, j: usize| list.as_ref().and_then(|l| l.get(j));
    for (j, (low, high)) in f.positions.iter().enumerate() {
        let farthest = low.abs().max(high.abs());
        let own = [limit(&limits.q_min_rad, j), limit(&limits.q_max_rad, j)].into_iter().flatten().map(f64::abs);
        let own = own.fold(f64::NAN, f64::max);
        let name = format!("joint {} ({})", j + 1, f.robot.joints[j]);
        if own > 0.0 && farthest > FAR_BEYOND * own {
            out.push(format!(
                "wrong unit? {name} is at up to {farthest:.1} rad; the robot file's limit is {own:.2} rad: degrees called rad?"
            ));
        } else if own.is_nan() && f.positions.len() > 1 && high - low > TURNS {
            out.push(format!(
                "wrong unit? {name} turns through {:.1} rad, {:.1} turns: degrees called rad?",
                high - low,
                (high - low) / std::f64::consts::TAU
            ));
        }
    }
}

/// Factor between the identified and the nominal rigid body, if one factor explains the departure: by the size of what
/// each column contributes.
fn common_factor(s: &Structure, solution: &Solution) -> Option<f64> {
    let (mut cross, mut nominal, mut own) = (0.0, 0.0, 0.0);
    for &b in &solution.excited {
        let column = &s.columns[s.base[b].column];
        let se = solution.standard_error(b);
        if !matches!(column.term, Term::Rigid(_)) || se.is_nan() || se <= 0.0 {
            continue;
        }
        let (x, y) = (s.base[b].nominal / se, solution.beta[b] / se);
        cross += x * y;
        nominal += x * x;
        own += y * y;
    }
    if nominal <= 0.0 || own <= 0.0 {
        return None;
    }
    // One factor must explain nearly all of it; otherwise it is the robot that differs, not the unit.
    let alike = cross * cross / (nominal * own);
    (alike > 0.9).then_some(cross / nominal)
}

/// A rigid-body parameter this many times the robot file's, or as many times below it, is off.
const OFF: f64 = 2.0;

/// Least and largest ratio of identified to nominal rigid-body parameters, if all that the data tell from zero are off the
/// same way: what one wrong factor does to a robot whose masses and rotors are not quite those of its file.
fn all_off(s: &Structure, solution: &Solution) -> Option<(f64, f64)> {
    let rigid = solution.excited.iter().filter(|&&b| {
        let column = &s.columns[s.base[b].column];
        let told = solution.beta[b].abs() > solution.half_width(b);
        matches!(column.term, Term::Rigid(_)) && s.base[b].nominal != 0.0 && told
    });
    let ratios: Vec<f64> = rigid.map(|&b| solution.beta[b] / s.base[b].nominal).collect();
    let (least, most) = ratios.iter().fold((f64::INFINITY, 0.0f64), |(l, m), r| (l.min(*r), m.max(*r)));
    (ratios.len() > 1 && least > 0.0 && (least > OFF || most < 1.0 / OFF)).then_some((least, most))
}

/// Error with standing joints beyond that of moving ones from which on it is worth a word.
const TRAP: f64 = 0.01;

fn standstill(f: &Findings<'_>, out: &mut Vec<String>) {
    if let Some(with) = f.with_standstill
        && with > 1.3 * f.held_out.relative_error
        && with > f.held_out.relative_error + TRAP
    {
        out.push(format!(
            "standstill trap: with standing joints fitted and counted the held-out error is {:.1} %, moving {:.1} %; a standing \
             joint holds any torque within its stiction, which no model of the motion predicts",
            100.0 * with,
            100.0 * f.held_out.relative_error
        ));
    }
}

fn timing(f: &Findings<'_>, out: &mut Vec<String>) {
    let Some(delay) = f.delay else { return };
    let rate = f.recordings.iter().map(|r| r.sample_rate_hz).fold(f64::INFINITY, f64::min);
    if delay.undone_s == 0.0 && delay.delay_s.abs() > 4.0 * delay.standard_error_s && delay.delay_s.abs() * rate > 2.0 {
        out.push(format!(
            "the torque is {:.2} ms {} the model ({:.1} sample periods): more than sampling explains (elasticity, a filter in \
             the drive?); not undone",
            1e3 * delay.delay_s.abs(),
            if delay.delay_s > 0.0 { "behind" } else { "ahead of" },
            delay.delay_s.abs() * rate
        ));
    }
}

/// Encoder noise in the accelerations that biases least squares.
fn encoder(f: &Findings<'_>, out: &mut Vec<String>) {
    let Some(i) = f.instruments.filter(|i| i.statistic.abs() > i.threshold) else { return };
    out.push(format!(
        "encoder noise in the accelerations biases least squares: {} = {}, by instruments {} ({:.1} standard errors \
         apart, {:.1} by chance at most); the model has the {}",
        i.symbol,
        significant(i.least_squares, 4),
        significant(i.instruments, 4),
        i.statistic.abs(),
        i.threshold,
        if i.used { "instruments'" } else { "least-squares values" }
    ));
}

fn quality(f: &Findings<'_>, out: &mut Vec<String>) {
    if let Some(c) = f.consistency.filter(|c| c.training_residual_ratio > 1.1) {
        out.push(format!(
            "links that could exist fit {:.0} % worse in training than free parameters (held out: {:.1} % against {:.1} %): \
             something that is not a rigid link carries load (a counterbalance, a spring), or the geometry is wrong",
            100.0 * (c.training_residual_ratio - 1.0),
            100.0 * f.held_out.relative_error,
            100.0 * c.free_relative_error
        ));
    }
    for (j, e) in f.held_out.relative_error_per_joint.iter().enumerate() {
        if *e > 0.5 {
            out.push(format!(
                "joint {} ({}): the model leaves {:.0} % of the held-out torque unexplained (rms {:.4} {})",
                j + 1,
                f.robot.joints[j],
                100.0 * e,
                f.held_out.rms_nm[j],
                f.robot.torque_unit.symbol()
            ));
        }
    }
    for (j, share) in f.solution.outliers.iter().enumerate() {
        if *share > 0.1 {
            out.push(format!(
                "joint {}: {:.0} % of the residuals lie beyond 2.5 standard deviations; expected 1 % (a missing effect, or \
                 events in the recordings)",
                j + 1,
                100.0 * share
            ));
        }
    }
}

/// The worst recording held out is missed this many times as badly as the median one, and by this much, before it is said.
const SPREAD: f64 = 2.5;
const MISSED: f64 = 0.1;

/// Recordings that do not predict each other: another robot, payload or unit, or a motion that tells nothing.
fn disagreement(f: &Findings<'_>, out: &mut Vec<String>) {
    if f.by_recording.len() < 3 || f.by_recording.len() != f.recordings.len() {
        return;
    }
    let mut sorted: Vec<(f64, &str)> =
        f.by_recording.iter().copied().zip(f.recordings.iter().map(|r| r.name.as_str())).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (Some(least), Some(most)) = (sorted.first(), sorted.last()) else { return };
    let median = sorted[sorted.len() / 2].0;
    if most.0 > SPREAD * median && most.0 > MISSED {
        out.push(format!(
            "the recordings do not agree: predicted from the others they are missed by {:.0} % ({}) to {:.0} % ({}), the median \
             one by {:.0} %: another robot, payload or unit in some, or a motion near a resonance?",
            100.0 * least.0,
            least.1,
            100.0 * most.0,
            most.1,
            100.0 * median
        ));
    }
}

/// Joints whose simulated motion is further off than a velocity that stays as it is.
fn simulated(f: &Findings<'_>, out: &mut Vec<String>) {
    let Some(forward) = f.forward else { return };
    let Some((own, held)) = forward.identified.rms_rad.last().zip(forward.held_velocity.rms_rad.last()) else { return };
    let worse: Vec<String> = (own.iter().zip(held).enumerate())
        .filter(|(_, (own, held))| *own > *held)
        .map(|(j, (own, held))| format!("joint {} ({:.3} rad, without {:.3})", j + 1, own, held))
        .collect();
    if !worse.is_empty() {
        out.push(format!(
            "not fit to simulate: {:.0} ms ahead of the measured state the model is further off than no model at {}",
            1e3 * forward.horizons_s.last().copied().unwrap_or(0.0),
            worse.join(", ")
        ));
    }
}
