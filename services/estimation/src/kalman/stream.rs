//! The fixed-lag smoother: the same steps as offline, with the future that has arrived.
//!
//! The smoother's step back is an affine map, x_k = a_k + C_k x_{k+1} with covariance A_k + C_k P C_kᵀ, and
//! affine maps compose. A sample's estimate is the composition of all maps from it to the newest sample,
//! applied to the newest filtered state. That is a sliding-window product: two stacks give it in constant
//! time per sample for any lag (the elements are those of Särkkä and García-Fernández 2021, eq. 19-20).

use super::gain::Gains;
use super::window::Window;
use super::{JointState, Lag, MotionModel, Settings};
use crate::error::EstimationError;

/// A smoothed sample as the fixed-lag smoother gives it out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LagEstimate<'a> {
    /// One per joint.
    pub joints: &'a [JointState],
    /// Its measurement time [ns].
    pub stamp_ns: i64,
    /// Time of the newest sample that shaped it [ns].
    pub newest_ns: i64,
    /// It is the first sample of a stretch: nothing before it was used.
    pub start: bool,
    /// The stretch began because of a gap in time (not set for the very first sample).
    pub gap: bool,
    /// It had less future than the lag.
    pub short: bool,
    /// A measurement of this sample was not a number and was bridged.
    pub bridged: bool,
}

/// Fixed-lag smoother of several joints. Allocates in [`FixedLag::new`] only.
#[derive(Debug, Clone)]
pub struct FixedLag {
    order: Order,
}

#[derive(Debug, Clone)]
enum Order {
    Three(Box<Window<3>>),
    Four(Box<Window<4>>),
}

/// When a sample has waited long enough: any of the three.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wait {
    pub lag_samples: usize,
    pub lag_ns: i64,
    /// Room for waiting samples.
    pub most: usize,
}

impl Wait {
    fn new(lag: Lag) -> Result<Self, EstimationError> {
        let (lag_samples, most, lag_ns) = match lag {
            Lag::Samples(n) => (n, n, i64::MAX),
            Lag::Seconds { lag_s, most } => {
                if !(0.0..=1e6).contains(&lag_s) {
                    let expected = "zero or a positive number up to 1e6";
                    return Err(EstimationError::Setting { what: "lag_s", found: lag_s, expected });
                }
                (usize::MAX, most, (lag_s * 1e9).round() as i64)
            }
        };
        if most > MOST_PENDING {
            let expected = "at most 65536 samples";
            return Err(EstimationError::Setting { what: "lag", found: most as f64, expected });
        }
        Ok(Self { lag_samples, lag_ns, most })
    }
}

/// Most samples that may wait.
const MOST_PENDING: usize = 65_536;

impl FixedLag {
    /// A smoother that has seen nothing.
    ///
    /// # Errors
    /// [`EstimationError`] for settings or a lag outside their range.
    pub fn new(settings: &Settings, lag: Lag) -> Result<Self, EstimationError> {
        settings.validate()?;
        let wait = Wait::new(lag)?;
        let order = match settings.model {
            MotionModel::ConstantAcceleration => Order::Three(Box::new(Window::new(settings, wait))),
            MotionModel::ConstantJerk => Order::Four(Box::new(Window::new(settings, wait))),
        };
        Ok(Self { order })
    }

    /// Goes on with other noise, gap and lag: gives out all waiting samples and starts anew with the next
    /// sample. Does not allocate; the room for waiting samples stays that of [`FixedLag::new`].
    ///
    /// # Errors
    /// [`EstimationError`] for settings or a lag outside their range, another model or number of joints, or a
    /// lag beyond the room; nothing is changed then.
    pub fn set(
        &mut self,
        settings: &Settings,
        lag: Lag,
        emit: &mut dyn FnMut(&LagEstimate<'_>),
    ) -> Result<(), EstimationError> {
        settings.validate()?;
        let wait = Wait::new(lag)?;
        let (states, joints, room) = match &self.order {
            Order::Three(w) => (3, w.joints(), w.room()),
            Order::Four(w) => (4, w.joints(), w.room()),
        };
        crate::error::same_length("states", settings.model.order(), states)?;
        crate::error::same_length("noise per joint", settings.noise.len(), joints)?;
        if wait.lag_samples != usize::MAX && wait.lag_samples > room {
            let expected = "within the room for waiting samples";
            return Err(EstimationError::Setting { what: "lag", found: wait.lag_samples as f64, expected });
        }
        self.finish(emit);
        match &mut self.order {
            Order::Three(w) => w.set(settings, wait),
            Order::Four(w) => w.set(settings, wait),
        }
        Ok(())
    }

    /// Takes the sample of time `stamp_ns` and gives out those that have waited long enough, in order.
    ///
    /// A step longer than the gap, or a stamp that does not increase, ends the stretch: all waiting samples
    /// are given out and the new one starts anew. `q_rad` has one entry per joint (missing ones are bridged).
    pub fn push(&mut self, stamp_ns: i64, q_rad: &[f64], emit: &mut dyn FnMut(&LagEstimate<'_>)) {
        match &mut self.order {
            Order::Three(w) => w.push(stamp_ns, q_rad, emit),
            Order::Four(w) => w.push(stamp_ns, q_rad, emit),
        }
    }

    /// The stream ended: gives out all waiting samples. The next one starts anew.
    pub fn finish(&mut self, emit: &mut dyn FnMut(&LagEstimate<'_>)) {
        match &mut self.order {
            Order::Three(w) => w.flush(emit),
            Order::Four(w) => w.flush(emit),
        }
    }

    /// Samples that wait.
    pub fn pending(&self) -> usize {
        match &self.order {
            Order::Three(w) => w.pending(),
            Order::Four(w) => w.pending(),
        }
    }

    /// True while sampling is regular and the gains have converged (the steady-state path).
    pub fn at_steady_state(&self) -> bool {
        match &self.order {
            Order::Three(w) => w.groups.iter().all(Gains::at_steady),
            Order::Four(w) => w.groups.iter().all(Gains::at_steady),
        }
    }
}
