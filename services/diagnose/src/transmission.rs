//! The drive train by itself, where sensors measure the torque behind the gears.
//!
//! τ_motor − τ_sensor = I_a θ̈ + f_v θ̇ + f_c s + offset + D dτ_sensor/dt + effects: friction is measured instead of inferred, no
//! mass of the arm is in it, and the load of the gear is the sensor's own signal. A gain error of motor or
//! sensor shows as a share of the load. D is the sensor's lag, which strain gauges and their filters have.

use crate::base::{Base, only, push};
use crate::model::BaseRole;
use crate::scene::{Raw, Scene};
use lacuna_estimation::filter::{Stencil, differentiate};

impl Base {
    /// Base of the drive train; the scene must have sensors ([`Scene::has_sensors`]).
    pub fn transmission(scene: &Scene) -> Self {
        let mut base = Self::bare(scene, false, true);
        base.fit_friction(scene);
        base.add_transmission(scene);
        base.hold_weakly(scene);
        base
    }

    /// Offsets, rotors and the sensors' lags.
    pub(crate) fn add_transmission(&mut self, scene: &Scene) {
        self.add_offsets(scene);
        let bends: Raw = scene.pieces.iter().map(|p| p.qdd.clone()).collect();
        let rate = |s: &Vec<f64>| {
            let mut smooth = s.clone();
            let ok = scene.smooth(&mut smooth);
            let rate = differentiate(&smooth, 1.0 / scene.rate_hz, Stencil::Seven, 1);
            rate.ok().filter(|_| ok).unwrap_or_else(|| vec![0.0; s.len()])
        };
        let rates: Raw = scene.pieces.iter().map(|p| p.sensor.iter().map(rate).collect()).collect();
        for j in 0..scene.joints {
            push(scene, &mut self.columns, BaseRole::Rotor(j), only(scene, &bends, j));
            push(scene, &mut self.columns, BaseRole::SensorLag(j), only(scene, &rates, j));
        }
    }
}
