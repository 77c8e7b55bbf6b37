//! Twins: the fitted model simulated on given references with the noise of the recordings, with and without
//! effects, many times. What diagnosis calibrates itself on.
//!
//! The model's parameters are mapped to the plant by what they mean, not by the estimator's regressors: a
//! Delta's twelve become arms, rods and platform of [`crate::plant::Delta`], a link's eleven become a body.

use crate::config::{LogConfig, SimulationConfig};
use crate::control::ControlConfig;
use crate::effects::{Scales, TrueEffect};
use crate::plant::friction::JointFriction;
use crate::plant::robot::JointTorque;
use crate::plant::{Mechanism, TrueRobot};
use crate::reference::Sampled;
use crate::simulation::{Noise, Plan, Study};
use lacuna_interfaces::model::Term;
use lacuna_interfaces::{BadInput, Joints, ModelFile, Recording, RobotFile};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// A motion that the twin is told to follow.
#[derive(Debug, Clone, PartialEq)]
pub struct TwinReference {
    /// Times [s], rising.
    pub t_s: Vec<f64>,
    /// Positions [rad], joint-major.
    pub q_rad: Vec<Vec<f64>>,
    /// Time of the first sample since the cold drives were switched on [s].
    pub start_s: f64,
}

/// What a twin has beside its model.
#[derive(Debug, Clone, PartialEq)]
pub struct TwinConfig {
    /// Noise of the torque log per joint, standard deviation [Nm].
    pub torque_noise_nm: Vec<f64>,
    /// Step of the encoder at the joint side [rad]; empty: the robot file's.
    pub encoder_step_rad: Vec<f64>,
    /// Encoder noise [steps].
    pub encoder_steps: f64,
    /// Sample rate of the twin's recordings [Hz].
    pub log_rate_hz: f64,
    /// Controller and step; [`TwinConfig::new`] takes a controller at the log's rate for speed.
    pub control: ControlConfig,
    /// Write temperature columns.
    pub temperature: bool,
}

impl TwinConfig {
    /// Longest simulation step of a twin [s].
    const STEP_S: f64 = 2.6e-4;

    /// Quick settings: the controller runs once a sample (at 500 Hz at least), steps are 0.25 ms.
    pub fn new(torque_noise_nm: Vec<f64>, log_rate_hz: f64) -> Self {
        let multiple = (500.0 / log_rate_hz).ceil().max(1.0);
        let rate_hz = log_rate_hz * multiple;
        let substeps = (1.0 / (rate_hz * Self::STEP_S)).ceil().clamp(1.0, 64.0) as u32;
        let base = ControlConfig::default();
        let velocity_filter_hz = base.velocity_filter_hz.min(0.2 * rate_hz);
        let bandwidth_hz = base.bandwidth_hz.min(0.02 * rate_hz);
        let control = ControlConfig { rate_hz, substeps, velocity_filter_hz, bandwidth_hz, ..base };
        Self {
            torque_noise_nm,
            encoder_step_rad: Vec::new(),
            encoder_steps: 3.0,
            log_rate_hz,
            control,
            temperature: false,
        }
    }
}

/// A fitted robot that can be simulated.
#[derive(Debug, Clone)]
pub struct Twin {
    robot: RobotFile,
    model: TrueRobot,
    scales: Scales,
    config: TwinConfig,
    noise: Noise,
    /// The model's own terms, before whatever a simulation adds.
    terms: Vec<TrueEffect>,
}

impl Twin {
    /// The robot as `model` says: rigid body, friction and terms. `urdf` is the text of the URDF that the
    /// robot file names.
    ///
    /// # Errors
    /// [`BadInput`] if model, robot and configuration do not fit together, a parameter has no counterpart in
    /// the plant, or a term is not an effect the plant knows.
    pub fn new(robot: &RobotFile, urdf: Option<&str>, model: &ModelFile, config: TwinConfig) -> Result<Self, BadInput> {
        model.check(robot)?;
        config.control.validate()?;
        let n = robot.joint_count();
        if config.torque_noise_nm.len() != n || !matches!(config.encoder_step_rad.len(), l if l == 0 || l == n) {
            return Err(BadInput::new(format!(
                "twin: found {} torque noises and {} encoder steps; expected {n} of each (encoder steps may be left out)",
                config.torque_noise_nm.len(),
                config.encoder_step_rad.len()
            )));
        }
        let mut fitted = TrueRobot::nominal(robot, urdf)?;
        let scales = Scales::of(robot, &fitted)?;
        rigid_body(&mut fitted, robot, model)?;
        for (i, joint) in fitted.joints.iter_mut().enumerate() {
            let of = |list: &[f64]| list.get(i).copied().unwrap_or(0.0);
            joint.friction = JointFriction::base(of(&model.friction.f_c), of(&model.friction.f_v));
            if of(&model.friction.offset) != 0.0 {
                joint.torque.push(JointTorque::Offset(of(&model.friction.offset)));
            }
        }
        let settings = SimulationConfig {
            log: LogConfig { rate_hz: Some(config.log_rate_hz), ..LogConfig::default() },
            noise: crate::config::NoiseConfig {
                torque_nm: config.torque_noise_nm.clone(),
                encoder_steps: config.encoder_steps,
                process_share: 0.0,
                ..Default::default()
            },
            ..SimulationConfig::default()
        };
        let mut noise = Noise::draw(robot, &settings, &scales, &fitted, &mut crate::random::Random::new(0, 0));
        for (step, given) in noise.encoder_step.iter_mut().zip(&config.encoder_step_rad) {
            *step = *given;
        }
        let terms = model.terms.iter().map(effect_of_term).collect();
        Ok(Self { robot: robot.clone(), model: fitted, scales, config, noise, terms })
    }

    /// Recordings of the twin with `effects` on top of its model.
    ///
    /// # Errors
    /// [`BadInput`] if an effect or a reference cannot be used, or the twin cannot follow.
    pub fn simulate(
        &self,
        references: &[TwinReference],
        effects: &[TrueEffect],
        seed: u64,
    ) -> Result<Vec<Recording>, BadInput> {
        let settings = self.settings(effects, seed);
        let plans: Vec<Plan> = references.iter().map(plan).collect::<Result<_, _>>()?;
        let study = Study::known(&self.robot, &self.model, &settings, self.scales.clone(), self.noise.clone())?;
        let scene = study.scene(&plans, None)?;
        let logged = study.run(&plans, &scene, &study.noise)?;
        Ok(study.recordings(&plans, &scene, &logged))
    }

    /// Many twins at once, in the order of `cases` (effects and seed of each), on all cores.
    pub fn simulate_many(
        &self,
        references: &[TwinReference],
        cases: &[(Vec<TrueEffect>, u64)],
    ) -> Vec<Result<Vec<Recording>, BadInput>> {
        cases.par_iter().map(|(effects, seed)| self.simulate(references, effects, *seed)).collect()
    }

    /// Scales of this robot, for drawing effect strengths.
    pub fn scales(&self) -> &Scales {
        &self.scales
    }

    /// The fitted plant, terms and effects not included.
    pub fn plant(&self) -> &TrueRobot {
        &self.model
    }

    fn settings(&self, effects: &[TrueEffect], seed: u64) -> SimulationConfig {
        SimulationConfig {
            seed,
            control: self.config.control,
            log: LogConfig {
                rate_hz: Some(self.config.log_rate_hz),
                temperature: self.config.temperature,
                ..LogConfig::default()
            },
            effects: self.terms.iter().chain(effects).cloned().collect(),
            ..SimulationConfig::default()
        }
    }
}

/// A model file's term as an effect of the plant: ids and symbols are the same.
pub fn effect_of_term(term: &Term) -> TrueEffect {
    TrueEffect { id: term.effect.clone(), joints: term.joints.clone(), params: term.parameters.clone() }
}

fn plan(reference: &TwinReference) -> Result<Plan, BadInput> {
    let duration_s = match (reference.t_s.first(), reference.t_s.last()) {
        (Some(a), Some(b)) => b - a,
        _ => 0.0,
    };
    let sampled = Sampled::new(&reference.t_s, &reference.q_rad)?;
    Ok(Plan { reference: Box::new(sampled), duration_s, start_s: reference.start_s })
}

/// Writes the model's rigid body into the plant.
fn rigid_body(fitted: &mut TrueRobot, robot: &RobotFile, model: &ModelFile) -> Result<(), BadInput> {
    let body = &model.rigid_body;
    match &mut fitted.mechanism {
        Mechanism::Delta(_) => {
            let mut pi = DeltaParameters::of(fitted);
            let (rho1, rho2) = (body.rho1.unwrap_or(1.0), body.rho2.unwrap_or(1.0));
            for i in 0..3 {
                pi.inertia[i] *= rho1;
                pi.along[i] *= rho2;
                pi.across[i] *= rho2;
            }
            for (symbol, value) in &body.parameters {
                *pi.slot(symbol).ok_or_else(|| unknown(symbol))? = *value;
            }
            pi.write(fitted);
        }
        Mechanism::Serial(chain) => {
            for (symbol, value) in &body.parameters {
                set_link(chain, &mut fitted.joints, symbol, *value).ok_or_else(|| unknown(symbol))?;
            }
        }
    }
    // A fit may leave parameters that no body has; as long as the inertia matrix is positive it can move.
    let limits = crate::reference::MotionLimits::of(robot);
    let mut q = Joints::default();
    (0..robot.joint_count()).for_each(|i| q[i] = 0.5 * (limits.q_min[i] + limits.q_max[i]));
    fitted.inertia(&q).map(|_| ()).map_err(|e| BadInput::new(format!("twin: the model at mid-range: {}", e.what)))
}

fn unknown(symbol: &str) -> BadInput {
    BadInput::new(format!("twin: rigid_body.parameters.{symbol}: found no such parameter of this kind of robot"))
}

/// A Delta's linear parameters by symbol: I, gc, gs per leg, and m_in, m_gr, m_JE.
struct DeltaParameters {
    inertia: [f64; 3],
    along: [f64; 3],
    across: [f64; 3],
    inert: f64,
    weighing: f64,
    coupling: f64,
}

/// What a forearm of mass m, centre ξ and inertia I_f does at the elbow, at the platform, and between them.
fn ends(rod: &crate::plant::delta::Forearm) -> [f64; 3] {
    let turning = rod.inertia / (rod.length * rod.length);
    let xi = rod.centre;
    [rod.mass * (1.0 - xi) * (1.0 - xi) + turning, rod.mass * xi * xi + turning, rod.mass * xi * (1.0 - xi) - turning]
}

impl DeltaParameters {
    fn of(robot: &TrueRobot) -> Self {
        let Mechanism::Delta(d) = &robot.mechanism else {
            return Self {
                inertia: [0.0; 3],
                along: [0.0; 3],
                across: [0.0; 3],
                inert: 0.0,
                weighing: 0.0,
                coupling: 0.0,
            };
        };
        let rod = &d.forearm[0];
        let [elbow, platform, coupling] = ends(rod);
        let leg = |i: usize| d.arm[i].inertia + elbow * d.arm[i].length.powi(2) + robot.joints[i].rotor;
        Self {
            inertia: [0, 1, 2].map(leg),
            along: [0, 1, 2].map(|i| d.arm[i].moment_along + rod.mass * (1.0 - rod.centre) * d.arm[i].length),
            across: [0, 1, 2].map(|i| d.arm[i].moment_across),
            inert: d.platform_kg + 3.0 * platform,
            weighing: d.platform_kg + d.weighing_kg + 3.0 * rod.mass * rod.centre,
            coupling,
        }
    }

    fn slot(&mut self, symbol: &str) -> Option<&mut f64> {
        match symbol {
            "m_in" => return Some(&mut self.inert),
            "m_gr" => return Some(&mut self.weighing),
            "m_JE" => return Some(&mut self.coupling),
            _ => {}
        }
        let (list, leg) = if let Some(leg) = symbol.strip_prefix("gc") {
            (&mut self.along, leg)
        } else if let Some(leg) = symbol.strip_prefix("gs") {
            (&mut self.across, leg)
        } else {
            (&mut self.inertia, symbol.strip_prefix('I')?)
        };
        list.get_mut(leg.parse::<usize>().ok()?.checked_sub(1)?)
    }

    /// Chooses bodies that have these parameters: rods of their present mass and half-way centre whose
    /// inertia gives the coupling, and arms and platform that make up the rest.
    fn write(&self, robot: &mut TrueRobot) {
        let Mechanism::Delta(d) = &mut robot.mechanism else { return };
        for rod in &mut d.forearm {
            rod.centre = 0.5;
            rod.inertia = (0.25 * rod.mass - self.coupling) * rod.length * rod.length;
        }
        let rod = d.forearm[0];
        let [elbow, platform, _] = ends(&rod);
        for i in 0..3 {
            let arm = &mut d.arm[i];
            arm.inertia = self.inertia[i] - elbow * arm.length.powi(2) - robot.joints[i].rotor;
            arm.moment_along = self.along[i] - 0.5 * rod.mass * arm.length;
            arm.moment_across = self.across[i];
        }
        d.platform_kg = self.inert - 3.0 * platform;
        d.weighing_kg = self.weighing - d.platform_kg - 1.5 * rod.mass;
    }
}

/// Sets one parameter of a link (`m3`, `mx3`, `Ixx3`, `Ia3`), in the frame the robot's description uses.
fn set_link(
    chain: &mut crate::plant::Serial,
    joints: &mut [crate::plant::robot::JointDrive],
    symbol: &str,
    value: f64,
) -> Option<()> {
    let digits = symbol.find(|c: char| c.is_ascii_digit())?;
    let (name, number) = symbol.split_at(digits);
    let i = number.parse::<usize>().ok()?.checked_sub(1)?;
    if name == "Ia" {
        joints.get_mut(i)?.rotor = value;
        return Some(());
    }
    let frame = *chain.described_in.get(i)?;
    let link = chain.links.get_mut(i)?;
    let mut body = link.body.placed(&frame.inverse());
    let at = |matrix: &mut Matrix3<f64>, r: usize, c: usize| {
        matrix[(r, c)] = value;
        matrix[(c, r)] = value;
    };
    let moment = |v: &mut Vector3<f64>, k: usize| v[k] = value;
    match name {
        "m" => body.mass = value,
        "mx" => moment(&mut body.moment, 0),
        "my" => moment(&mut body.moment, 1),
        "mz" => moment(&mut body.moment, 2),
        "Ixx" => at(&mut body.inertia, 0, 0),
        "Ixy" => at(&mut body.inertia, 0, 1),
        "Ixz" => at(&mut body.inertia, 0, 2),
        "Iyy" => at(&mut body.inertia, 1, 1),
        "Iyz" => at(&mut body.inertia, 1, 2),
        "Izz" => at(&mut body.inertia, 2, 2),
        _ => return None,
    }
    link.body = body.placed(&frame);
    Some(())
}
