//! The motion behind a real recording: positions low-passed without phase, differentiated, at the recording's own
//! times.

use crate::error::Error;
use lacuna_estimation::filter::{Interpolation, Stencil, ZeroPhase, differentiate, regular_grid, resample};
use lacuna_interfaces::Recording;

/// Position and derivatives, and the torque in the same band; joint-major, one value per sample of the recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Time [s].
    pub t_s: Vec<f64>,
    /// Position [rad].
    pub q: Vec<Vec<f64>>,
    /// Velocity [rad/s].
    pub qd: Vec<Vec<f64>>,
    /// Acceleration [rad/s²].
    pub qdd: Vec<Vec<f64>>,
    /// Measured torque [Nm].
    pub tau: Vec<Vec<f64>>,
}

/// Corner of the low-pass [Hz].
const BAND_HZ: f64 = 20.0;

impl Motion {
    /// Of a recording.
    ///
    /// # Errors
    /// If it is too short, or its time does not rise.
    pub fn of(recording: &Recording) -> Result<Self, Error> {
        let name = &recording.name;
        let period = recording.median_period_s().filter(|p| *p > 0.0);
        let (Some(period), Some(&first), Some(&last)) = (period, recording.t_s.first(), recording.t_s.last()) else {
            return Err(Error::Run(format!("{name}: found too few samples; expected a recording of some seconds")));
        };
        let grid = regular_grid(first, last, period);
        let filter = ZeroPhase::butterworth(4, BAND_HZ.min(0.2 / period), 1.0 / period)?;
        let smooth = |column: &Vec<f64>| -> Result<Vec<f64>, Error> {
            Ok(filter.apply(&resample(&recording.t_s, column, &grid, Interpolation::Linear)?)?)
        };
        let back = |column: &[f64]| -> Result<Vec<f64>, Error> {
            Ok(resample(&grid, column, &recording.t_s, Interpolation::Linear)?)
        };
        let mut motion =
            Self { t_s: recording.t_s.clone(), q: Vec::new(), qd: Vec::new(), qdd: Vec::new(), tau: Vec::new() };
        for column in &recording.q_rad {
            let q = smooth(column)?;
            motion.qd.push(back(&differentiate(&q, period, Stencil::Seven, 1)?)?);
            motion.qdd.push(back(&differentiate(&q, period, Stencil::Seven, 2)?)?);
            motion.q.push(back(&q)?);
        }
        for column in &recording.tau_nm {
            motion.tau.push(back(&smooth(column)?)?);
        }
        Ok(motion)
    }
}
