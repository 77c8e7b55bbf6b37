//! What a message of the graph becomes on the topics: the table at the top of this crate, line by line.

use crate::streams::{Stream, Topics};
use lacuna_interfaces::{
    FrictionTorque, JointMeasured, JointSmoothed, MAX_JOINTS, PayloadEstimate, ResidualWatch, TorqueModel, flag,
};
use lacuna_recording::topics::Messages;

impl Topics {
    /// Writes a measured sample.
    pub fn measured(&self, m: &JointMeasured, to: &mut impl Messages) {
        let n = self.joints;
        let there = |values: &[f64]| values.iter().any(|v| !v.is_nan());
        let drive_on = !m.header.has(flag::DRIVE_OFF);
        if !drive_on || there(&m.temperature_degc[..n]) || there(&m.link_q_rad[..n]) || there(&m.link_tau_nm[..n]) {
            // Before its JointState, so that a reader has it when the sample comes.
            self.write(Self::MEASURED_DETAIL, to, &m.header, |slots| {
                slots
                    .numbers(&m.temperature_degc[..n])
                    .numbers(&m.link_q_rad[..n])
                    .numbers(&m.link_tau_nm[..n])
                    .bytes(&[u8::from(drive_on)])
                    .done();
            });
        }
        self.write(Self::MEASURED, to, &m.header, |s| s.numbers(&m.q_rad[..n]).numbers(&m.tau_nm[..n]).done());
        self.status(Stream::Measured, to, &m.header);
    }

    /// Writes a smoothed sample.
    pub fn smoothed(&self, m: &JointSmoothed, to: &mut impl Messages) {
        let n = self.joints;
        self.write(Self::SMOOTHED, to, &m.header, |s| s.numbers(&m.q_rad[..n]).numbers(&m.qd_rad_s[..n]).done());
        self.write(Self::SMOOTHED_DETAIL, to, &m.header, |slots| {
            slots
                .numbers(&m.qdd_rad_s2[..n])
                .numbers(&m.sd_q_rad[..n])
                .numbers(&m.sd_qd_rad_s[..n])
                .numbers(&m.sd_qdd_rad_s2[..n])
                .done();
        });
        self.status(Stream::Smoothed, to, &m.header);
    }

    /// Writes model torques.
    pub fn torque(&self, m: &TorqueModel, to: &mut impl Messages) {
        let n = self.joints;
        self.write(Self::TORQUE_NOMINAL, to, &m.header, |s| s.numbers(&m.tau_nominal_nm[..n]).done());
        self.write(Self::TORQUE_RIGID, to, &m.header, |s| s.numbers(&m.tau_rigid_nm[..n]).done());
        self.status(Stream::Torque, to, &m.header);
    }

    /// Writes friction torques.
    pub fn friction(&self, m: &FrictionTorque, to: &mut impl Messages) {
        let n = self.joints;
        self.write(Self::FRICTION, to, &m.header, |s| s.numbers(&m.tau_friction_nm[..n]).done());
        self.status(Stream::Friction, to, &m.header);
    }

    /// Writes a payload estimate and the residuals.
    pub fn payload(&self, m: &PayloadEstimate, to: &mut impl Messages) {
        let n = self.joints;
        self.write(Self::RESIDUAL, to, &m.header, |s| s.numbers(&m.residual_nm[..n]).done());
        self.write(Self::RESIDUAL_PAYLOAD, to, &m.header, |s| s.numbers(&m.residual_payload_nm[..n]).done());
        self.write(Self::PAYLOAD, to, &m.header, |slots| {
            slots
                .bytes(&m.mass_kg.to_le_bytes())
                .bytes(&m.sd_mass_kg.to_le_bytes())
                .bytes(&[u8::from(!m.header.has(flag::NOT_EXCITED))])
                .bytes(&[u8::from(m.header.has(flag::PAYLOAD_STEP))])
                .done();
        });
        self.status(Stream::Payload, to, &m.header);
    }

    /// Writes what the monitor makes of the residual.
    pub fn watch(&self, m: &ResidualWatch, to: &mut impl Messages) {
        let n = self.joints;
        self.write(Self::WATCH, to, &m.header, |mut slots| {
            slots = slots.numbers(&m.residual_nm[..n]).numbers(&m.sd_nm[..n]).numbers(&m.score[..n]);
            let (mut alarm, mut watched) = ([0; MAX_JOINTS], [0; MAX_JOINTS]);
            for j in 0..n {
                alarm[j] = (m.alarm >> j & 1) as u8;
                watched[j] = (m.watched >> j & 1) as u8;
            }
            slots = slots.bytes(&watched[..n]).bytes(&alarm[..n]);
            let since = m.since_ns.map(|ns| ns as f64 * 1e-9);
            let variable = m.region_variable.map(|v| v as u8);
            slots = slots.numbers(&since[..n]).bytes(&variable[..n]);
            slots.numbers(&m.region_low[..n]).numbers(&m.region_high[..n]).done();
        });
        self.status(Stream::Watch, to, &m.header);
    }
}
