//! Conditioning of recorded signals, offline: zero-phase low-pass, differentiators, resampling, repair of
//! spikes and wrapped angles, and noise estimates.
//!
//! Everything here works on regular sampling except [`resample`] and [`differentiate_irregular`], which take
//! the time of every sample.

mod butterworth;
mod differentiate;
mod noise;
mod repair;
mod resample;

pub use butterworth::ZeroPhase;
pub use differentiate::{Stencil, differentiate, differentiate_irregular, stencil_weights};
pub use noise::{noise_sd, noise_sd_of_order};
pub use repair::{SpikeRule, find_spikes, median_filter, remove_spikes, unwrap_angles};
pub use resample::{Interpolation, decimate, median_step, regular_grid, resample, segments};
