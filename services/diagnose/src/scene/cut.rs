//! From a recording as it was read to stretches on one regular grid.

use super::Piece;
use lacuna_estimation::filter::{Interpolation, SpikeRule, ZeroPhase, regular_grid, remove_spikes, resample, segments};
use lacuna_estimation::stats;
use lacuna_interfaces::{BadInput, Recording, Repair, RepairKind, RobotFile};
use std::f64::consts::TAU;

/// Highest rate of the analysis [Hz]; faster recordings are thinned out.
const MAX_RATE_HZ: f64 = 1000.0;

/// Median rate of the recordings, at most [`MAX_RATE_HZ`].
///
/// # Errors
/// [`BadInput`] if there is none.
pub(super) fn common_rate(recordings: &[Recording]) -> Result<f64, BadInput> {
    let mut rates: Vec<f64> = recordings.iter().filter_map(Recording::median_period_s).map(|dt| 1.0 / dt).collect();
    let rate = stats::median_in_place(&mut rates);
    if !(rate.is_finite() && rate > 1.0) {
        return Err(BadInput::new("recordings: found no usable sample rate; expected at least one recording"));
    }
    Ok(rate.min(MAX_RATE_HZ))
}

/// Cuts a recording at gaps, repairs spikes and puts it on the common grid.
///
/// # Errors
/// [`BadInput`] if a signal cannot be resampled.
pub(super) fn cut(
    robot: &RobotFile,
    recording: &Recording,
    index: usize,
    global_s: f64,
    rate_hz: f64,
    repairs: &mut Vec<Repair>,
) -> Result<Vec<Piece>, BadInput> {
    let joints = recording.q_rad.len();
    repairs.extend(recording.repairs.iter().cloned());
    let mut tau = recording.tau_nm.clone();
    for (j, signal) in tau.iter_mut().enumerate() {
        let count = remove_spikes(signal, &SpikeRule::default()).len() as u64;
        if count > 0 {
            let signal = format!("tau{}", j + 1);
            repairs.push(Repair { file: recording.name.clone(), kind: RepairKind::Spike, signal, count });
        }
    }
    let column = |name: &String| recording.extra.get(name).cloned();
    let temperature: Vec<Vec<f64>> = match robot.columns.temperature.as_slice() {
        [] => {
            (1..=joints).filter_map(|j| column(&format!("temp{j}")).or_else(|| column(&format!("x_temp{j}")))).collect()
        }
        names => names.iter().filter_map(column).collect(),
    };
    let temperature = if temperature.len() == joints { temperature } else { Vec::new() };
    // A recording without the columns that the robot file names is read without them.
    let all_of = |names: &[String]| names.iter().map(column).collect::<Option<Vec<_>>>().unwrap_or_default();
    let mut link_q = all_of(&robot.columns.link_position);
    for (link, q) in link_q.iter_mut().zip(&recording.q_rad) {
        // The reader has unwrapped q; a second encoder may still jump by whole turns against it.
        link.iter_mut().zip(q).for_each(|(l, q)| *l -= TAU * ((*l - q) / TAU).round());
    }
    let sensor = all_of(&robot.columns.link_torque);
    let sensor = if sensor.len() == joints { sensor } else { Vec::new() };
    let enabled = robot.columns.enabled.as_ref().and_then(column);
    let native = recording.median_period_s().map_or(rate_hz, |dt| 1.0 / dt);
    let gap = 8.0 / native;
    let mut out = Vec::new();
    for range in segments(&recording.t_s, gap) {
        let t = &recording.t_s[range.clone()];
        let (Some(first), Some(last)) = (t.first(), t.last()) else { continue };
        if (last - first) * rate_hz < 64.0 {
            continue;
        }
        let grid = regular_grid(*first, *last, 1.0 / rate_hz);
        let even = t.len() == grid.len() && t.iter().zip(&grid).all(|(a, b)| (a - b).abs() < 0.02 / rate_hz);
        let fit = |x: &[f64], how| -> Result<Vec<f64>, BadInput> {
            let x = &x[range.clone()];
            if even {
                return Ok(x.to_vec());
            }
            if native > 1.5 * rate_hz {
                // Thinning out: low-pass first, or what is above folds down.
                let smooth = ZeroPhase::butterworth(4, 0.4 * rate_hz, native).and_then(|f| f.apply(x))?;
                return Ok(resample(t, &smooth, &grid, how)?);
            }
            Ok(resample(t, x, &grid, how)?)
        };
        let all = |signals: &[Vec<f64>], how| signals.iter().map(|s| fit(s, how)).collect::<Result<Vec<_>, _>>();
        let on = match &enabled {
            Some(e) => fit(e, Interpolation::Linear)?.iter().map(|v| *v > 0.999).collect(),
            None => vec![true; grid.len()],
        };
        out.push(Piece {
            recording: index,
            t0_s: *first,
            global_s: global_s + first - recording.t_s.first().unwrap_or(first),
            q: all(&recording.q_rad, Interpolation::Cubic)?,
            qd: vec![Vec::new(); joints],
            qdd: vec![Vec::new(); joints],
            tau: all(&tau, Interpolation::Linear)?,
            temperature: all(&temperature, Interpolation::Linear)?,
            link_q: all(&link_q, Interpolation::Cubic)?,
            sensor: all(&sensor, Interpolation::Linear)?,
            enabled: on,
            rows: 0..0,
        });
    }
    Ok(out)
}
