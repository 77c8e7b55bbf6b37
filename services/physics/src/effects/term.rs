//! The terms of a model file at work on the stream.

use super::catalogue;
use super::context::EffectContext;
use super::effect::Effect;
use super::kernel::{ColumnSink, EffectSample, Kernel};
use super::specification::Side;
use lacuna_interfaces::model::Term;
use lacuna_interfaces::{BadInput, Joints, MAX_JOINTS, ModelFile};

/// One term: a kernel and its amplitudes.
pub struct TermState {
    effect: &'static Effect,
    kernel: Box<dyn Kernel>,
    factors: Vec<f64>,
    n: usize,
    columns: Vec<f64>,
}

impl std::fmt::Debug for TermState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TermState").field("effect", &self.effect.id).field("factors", &self.factors).finish()
    }
}

impl TermState {
    pub(super) fn new(effect: &'static Effect, kernel: Box<dyn Kernel>, factors: Vec<f64>, n: usize) -> Self {
        let columns = vec![0.0; factors.len() * n];
        Self { effect, kernel, factors, n, columns }
    }

    /// The effect it is an instance of.
    pub fn effect(&self) -> &'static Effect {
        self.effect
    }

    /// Forgets everything: the next sample is the first.
    pub fn reset(&mut self) {
        self.kernel.reset();
    }

    /// Adds its torque at this sample [Nm] to `tau_nm`. A torque that is not finite is not added.
    pub fn add_torque(&mut self, sample: &EffectSample<'_>, tau_nm: &mut Joints) {
        self.kernel.columns(sample, &mut ColumnSink::new(self.n, &mut self.columns));
        for (factor, column) in self.factors.iter().zip(self.columns.chunks_exact(self.n.max(1))) {
            for (tau, c) in tau_nm.iter_mut().zip(column) {
                let add = factor * c;
                if add.is_finite() {
                    *tau += add;
                }
            }
        }
    }
}

/// One sample of the stream as the terms take it.
#[derive(Debug, Clone, Copy)]
pub struct TermInput<'a> {
    /// Measurement time on the recording's clock [ns].
    pub stamp_ns: i64,
    /// Joint positions [rad].
    pub q_rad: &'a Joints,
    /// Joint velocities [rad/s].
    pub qd_rad_s: &'a Joints,
    /// Joint accelerations [rad/s²].
    pub qdd_rad_s2: &'a Joints,
    /// sgn θ̇ with the stage's treatment of standstill.
    pub direction: &'a Joints,
    /// See [`EffectSample::ramp_rad_s`].
    pub ramp_rad_s: f64,
    /// Rigid-body torque of the model in use, rotors included [Nm].
    pub tau_rigid_nm: &'a Joints,
    /// Temperatures [°C]; NaN where there is none.
    pub temperature_degc: &'a Joints,
}

/// All terms of a model, in the order in which they act on one another.
#[derive(Debug)]
pub struct Terms {
    terms: Vec<TermState>,
    rotor: Joints,
    last_stamp_ns: Option<i64>,
}

impl Terms {
    /// The terms of `list`. Within a [`Side`] they keep their order.
    ///
    /// # Errors
    /// [`BadInput`] naming the term, what was found and what was expected.
    pub fn new(list: &[Term], context: &EffectContext<'_>) -> Result<Self, BadInput> {
        let mut terms = Vec::with_capacity(list.len());
        for (i, term) in list.iter().enumerate() {
            terms.push(one(term, context).map_err(|e| BadInput { what: format!("term[{i}]: {}", e.what), ..e })?);
        }
        terms.sort_by_key(|t: &TermState| t.effect.side);
        Ok(Self { terms, rotor: context.rotor_inertia_kg_m2(), last_stamp_ns: None })
    }

    /// True if there is no term.
    pub fn is_empty(&self) -> bool {
        self.terms.is_empty()
    }

    /// The terms, in the order in which they run.
    pub fn iter(&self) -> impl Iterator<Item = &TermState> {
        self.terms.iter()
    }

    /// Forgets everything: the next sample is the first (start of stream, gap).
    pub fn reset(&mut self) {
        self.last_stamp_ns = None;
        self.terms.iter_mut().for_each(TermState::reset);
    }

    /// Adds the torque of all terms [Nm] to `tau_nm`, which on entry holds the friction that is not in terms.
    /// Steps the memories over the time since the sample before. Never allocates.
    ///
    /// A sample whose motion is not finite adds nothing and resets the memories.
    pub fn add_torque(&mut self, input: &TermInput<'_>, tau_nm: &mut Joints) {
        if self.terms.is_empty() {
            return;
        }
        let finite = |x: &Joints| x.iter().all(|v| v.is_finite());
        if !(finite(input.q_rad) && finite(input.qd_rad_s) && finite(input.qdd_rad_s2) && finite(input.tau_rigid_nm)) {
            self.reset();
            return;
        }
        let since = self.last_stamp_ns.map_or(0, |last| input.stamp_ns.saturating_sub(last));
        self.last_stamp_ns = Some(input.stamp_ns);
        let friction = *tau_nm;
        let mut tau_link: Joints = std::array::from_fn(|j| input.tau_rigid_nm[j] - self.rotor[j] * input.qdd_rad_s2[j]);
        let mut tau_drive = [0.0; MAX_JOINTS];
        let mut side = Side::Link;
        for term in &mut self.terms {
            // Each side sees what the sides before it have added.
            if term.effect.side != side {
                if side == Side::Link {
                    for j in 0..MAX_JOINTS {
                        tau_link[j] += tau_nm[j] - friction[j];
                    }
                }
                side = term.effect.side;
            }
            if side == Side::Drive {
                tau_drive = std::array::from_fn(|j| input.tau_rigid_nm[j] + tau_nm[j]);
            }
            let sample = EffectSample {
                t_s: input.stamp_ns as f64 * 1e-9,
                dt_s: since as f64 * 1e-9,
                q_rad: input.q_rad,
                qd_rad_s: input.qd_rad_s,
                qdd_rad_s2: input.qdd_rad_s2,
                direction: input.direction,
                ramp_rad_s: input.ramp_rad_s,
                tau_link_nm: &tau_link,
                tau_drive_nm: &tau_drive,
                temperature_degc: input.temperature_degc,
            };
            term.add_torque(&sample, tau_nm);
        }
    }
}

/// The terms of a model file, ready to run. The model is expected to have passed [`ModelFile::check`].
///
/// # Errors
/// As [`Terms::new`].
pub fn build_terms(model: &ModelFile, context: &EffectContext<'_>) -> Result<Terms, BadInput> {
    Terms::new(&model.terms, context)
}

fn one(term: &Term, context: &EffectContext<'_>) -> Result<TermState, BadInput> {
    let Some(effect) = catalogue::find(&term.effect) else {
        let known: Vec<&str> = catalogue::registry().iter().map(|e| e.id).collect();
        return Err(BadInput::new(format!("found effect \"{}\"; expected one of {}", term.effect, known.join(", "))));
    };
    let mut joints = Vec::with_capacity(term.joints.len());
    for name in &term.joints {
        let Some(j) = context.robot.joints.iter().position(|known| known == name) else {
            let known = context.robot.joints.join(", ");
            return Err(BadInput::new(format!("{}: found joint \"{name}\"; expected one of {known}", effect.id)));
        };
        joints.push(j);
    }
    effect.term(&joints, &term.parameters, context)
}
