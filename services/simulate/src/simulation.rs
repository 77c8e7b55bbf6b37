//! From a configuration to recordings and their truth.

use crate::config::{FrictionConfig, SimulationConfig};
use crate::effects::{self, Scales};

use crate::log::Logged;
use crate::oracle::Oracle;
use crate::output::{Manifest, ManifestFile, recording_of, reference_columns};
use crate::plant::friction::JointFriction;
use crate::plant::robot::TipEvent;
use crate::plant::{Mechanism, TrueRobot};
use crate::random::Random;
use crate::reference::{self, MotionLimits, Reference};
use crate::run::{Setup, run};
use crate::truth::{BaseFriction, EffectTruth, EventTruth, NoiseTruth, Truth, pooled_rms};
use lacuna_interfaces::{BadInput, Joints, Recording, RobotFile};
use rayon::prelude::*;

/// Recordings and what is true of them.
#[derive(Debug, Clone)]
pub struct Simulation {
    /// The recordings, `traj_01.csv` and on.
    pub recordings: Vec<Recording>,
    /// Start times and durations.
    pub manifest: Manifest,
    /// What the robot truly is and what happened.
    pub truth: Truth,
    /// Noise-free motion and hidden torque behind every recording.
    pub behind: Vec<Logged>,
}

/// A trajectory to simulate: reference, duration, start.
#[derive(Debug)]
pub(crate) struct Plan {
    pub reference: Box<dyn Reference>,
    pub duration_s: f64,
    pub start_s: f64,
}

/// Streams of the seed; every trajectory has its own, see also `effects`.
mod stream {
    pub const ROBOT: u64 = 0;
    pub const PAUSES: u64 = 2;
    pub const REFERENCES: u64 = 1 << 20;
    pub const TRAJECTORY: u64 = 1 << 21;
    pub const TEMPERATURE: u64 = 3 << 20;
    pub const LOG: u64 = 5 << 20;
}

/// Simulates closed-loop recordings of `robot`; `urdf` is the text of the URDF that the robot file names.
/// The same input gives the same recordings to the last bit, on any number of threads.
///
/// # Errors
/// [`BadInput`] if configuration and robot do not fit, or the robot cannot follow (workspace, inertia).
pub fn simulate(robot: &RobotFile, urdf: Option<&str>, config: &SimulationConfig) -> Result<Simulation, BadInput> {
    config.validate(robot)?;
    let mut nominal = TrueRobot::nominal(robot, urdf)?;
    for (joint, rotor) in nominal.joints.iter_mut().zip(&config.rotor_inertia) {
        joint.rotor += rotor;
    }
    let limits = MotionLimits::of(robot);
    let mut pauses = Random::new(config.seed, stream::PAUSES);
    let mut start_s = 0.0;
    let mut plans = Vec::new();
    for group in &config.trajectories {
        for _ in 0..group.count {
            let mut random = Random::new(config.seed, stream::REFERENCES + plans.len() as u64);
            let reference =
                reference::draw(group.kind, &nominal, &limits, group.duration_s, group.intensity, &mut random)?;
            plans.push(Plan { reference, duration_s: group.duration_s, start_s });
            start_s += group.duration_s + 2.0 * config.log.pause_s * pauses.unit();
        }
    }
    let study = Study::new(robot, &nominal, config)?;
    let scene = study.scene(&plans, None)?;
    let logged = study.run(&plans, &scene, &study.noise)?;
    study.report(&plans, &scene, logged)
}

/// A robot under a configuration: what all its trajectories share.
pub(crate) struct Study<'a> {
    robot: &'a RobotFile,
    nominal: &'a TrueRobot,
    config: &'a SimulationConfig,
    scales: Scales,
    /// The true robot before effects.
    bare: TrueRobot,
    friction: BaseFriction,
    pub(crate) noise: Noise,
    divider: usize,
}

/// The true robot with its effects, and what happens at its tip in every trajectory.
pub(crate) struct Scene {
    truth: TrueRobot,
    events: Vec<Vec<TipEvent>>,
}

impl<'a> Study<'a> {
    fn new(robot: &'a RobotFile, nominal: &'a TrueRobot, config: &'a SimulationConfig) -> Result<Self, BadInput> {
        let scales = Scales::of(robot, nominal)?;
        let mut random = Random::new(config.seed, stream::ROBOT);
        let mut bare = nominal.clone();
        perturb(&mut bare, config.mass_error, &mut random);
        let friction = base_friction(&config.friction, &scales, &mut bare, &mut random);
        let noise = Noise::draw(robot, config, &scales, &bare, &mut random);
        Ok(Self { robot, nominal, config, scales, bare, friction, noise, divider: config.log_divider(robot)? })
    }

    /// A study of a robot that is known already: no draws.
    pub(crate) fn known(
        robot: &'a RobotFile,
        model: &'a TrueRobot,
        config: &'a SimulationConfig,
        scales: Scales,
        noise: Noise,
    ) -> Result<Self, BadInput> {
        let of = |get: fn(&JointFriction) -> f64| model.joints.iter().map(|j| get(&j.friction)).collect();
        let friction = BaseFriction { fc: of(|f| f.coulomb_positive), fv: of(|f| f.viscous) };
        let divider = config.log_divider(robot)?;
        Ok(Self { robot, nominal: model, config, scales, bare: model.clone(), friction, noise, divider })
    }

    /// The robot with all effects but number `left_out`.
    pub(crate) fn scene(&self, plans: &[Plan], left_out: Option<usize>) -> Result<Scene, BadInput> {
        let mut scene = Scene { truth: self.bare.clone(), events: vec![Vec::new(); plans.len()] };
        let plans: Vec<_> = plans.iter().map(|p| (p.duration_s, p.reference.grips().to_vec())).collect();
        let target = effects::Target { truth: &mut scene.truth, events: &mut scene.events, plans: &plans };
        effects::apply(&self.config.effects, self.robot, &self.scales, target, self.config.seed, left_out)?;
        Ok(scene)
    }

    /// Runs all trajectories.
    pub(crate) fn run(&self, plans: &[Plan], scene: &Scene, noise: &Noise) -> Result<Vec<Logged>, BadInput> {
        let setup = Setup {
            robot: self.robot,
            truth: &scene.truth,
            nominal: self.nominal,
            control: self.config.control,
            divider: self.divider,
            torque_noise: noise.torque,
            encoder_step: noise.encoder_step,
            encoder_noise: noise.encoder_steps,
            process_noise: noise.process,
            spikes_per_s: noise.spikes_per_s,
        };
        let trajectory = |(k, (plan, events)): (usize, (&Plan, &Vec<TipEvent>))| {
            let random = [stream::TRAJECTORY, stream::LOG].map(|s| Random::new(self.config.seed, s + k as u64));
            run(&setup, plan.reference.as_ref(), events, plan.duration_s, plan.start_s, random)
        };
        plans.par_iter().zip(&scene.events).enumerate().map(trajectory).collect()
    }

    /// Recordings of what was logged.
    pub(crate) fn recordings(&self, plans: &[Plan], scene: &Scene, logged: &[Logged]) -> Vec<Recording> {
        let warm_up: Vec<Option<f64>> =
            scene.truth.joints.iter().map(|j| j.friction.thermal.first().map(|law| law.time_constant)).collect();
        let entry = |(k, (plan, logged)): (usize, (&Plan, &Logged))| {
            let mut random = Random::new(self.config.seed, stream::TEMPERATURE + k as u64);
            let warm_up = self.config.log.temperature.then_some(warm_up.as_slice());
            let mut recording = recording_of(self.robot, logged, k, warm_up, plan.start_s, &mut random);
            if self.config.log.reference {
                recording.extra.extend(reference_columns(logged));
            }
            recording
        };
        plans.iter().zip(logged).enumerate().map(entry).collect()
    }

    fn report(&self, plans: &[Plan], scene: &Scene, behind: Vec<Logged>) -> Result<Simulation, BadInput> {
        let recordings = self.recordings(plans, scene, &behind);
        let file = |(r, p): (&Recording, &Plan)| ManifestFile {
            file: r.name.clone(),
            start_time_s: (p.start_s * 1e3).round() / 1e3,
            duration_s: p.duration_s,
        };
        let files = recordings.iter().zip(plans).map(file).collect();
        let manifest = Manifest { files, note: Manifest::NOTE.to_owned() };
        let n = self.robot.joint_count();
        let pooled = |i: usize| pooled_rms(behind.iter().filter_map(|l| l.hidden_nm.get(i)).map(Vec::as_slice));
        let mut effects: Vec<EffectTruth> =
            self.config.effects.iter().map(|e| EffectTruth::of(e, self.robot)).collect::<Result<_, _>>()?;
        if self.config.measure_effects {
            for (effect, size) in effects.iter_mut().zip(self.effect_sizes(plans, scene)?) {
                effect.rms_nm = size;
            }
        }
        let truth = Truth {
            schema: Truth::SCHEMA.to_owned(),
            robot: self.robot.name.clone(),
            seed: self.config.seed,
            mass_error: self.config.mass_error,
            base: if self.config.friction.none { "ideal" } else { "friction" }.to_owned(),
            base_params: self.friction.clone(),
            effects,
            events: recordings.iter().zip(&scene.events).map(|(r, e)| (r.name.clone(), EventTruth::of(e))).collect(),
            noise: NoiseTruth {
                torque_nm: self.noise.torque[..n].to_vec(),
                encoder_step_rad: self.noise.encoder_step[..n].to_vec(),
                encoder_steps: self.noise.encoder_steps,
            },
            hidden_rms_nm: (0..n).map(pooled).collect(),
            oracle: Oracle::of(self.nominal, &recordings, &behind),
            tracking_error_rad: behind.iter().map(|l| l.tracking_error_rad).fold(0.0, f64::max),
        };
        Ok(Simulation { recordings, manifest, truth, behind })
    }

    /// RMS torque per joint that each effect is behind: the hidden torque with all effects less that with
    /// all but this one, both in closed loop on the same references without noise.
    fn effect_sizes(&self, plans: &[Plan], scene: &Scene) -> Result<Vec<Vec<f64>>, BadInput> {
        let quiet = self.noise.silenced();
        let with = self.run(plans, scene, &quiet)?;
        let size = |k: usize| {
            let without = self.run(plans, &self.scene(plans, Some(k))?, &quiet)?;
            let joint = |i: usize| {
                let differences: Vec<Vec<f64>> = with
                    .iter()
                    .zip(&without)
                    .map(|(a, b)| a.hidden_nm[i].iter().zip(&b.hidden_nm[i]).map(|(x, y)| x - y).collect())
                    .collect();
                pooled_rms(differences.iter().map(Vec::as_slice))
            };
            Ok((0..self.robot.joint_count()).map(joint).collect())
        };
        (0..self.config.effects.len()).map(size).collect()
    }
}

/// Masses, centres of mass and inertias off by up to `share`, each body alone.
fn perturb(truth: &mut TrueRobot, share: f64, random: &mut Random) {
    let mut off = || 1.0 + random.uniform(-share, share);
    match &mut truth.mechanism {
        Mechanism::Delta(d) => {
            d.platform_kg *= off();
            for arm in &mut d.arm {
                let mass = off();
                arm.moment_along *= mass;
                arm.inertia *= mass;
            }
            for rod in &mut d.forearm {
                let mass = off();
                rod.mass *= mass;
                rod.inertia *= mass;
            }
        }
        Mechanism::Serial(chain) => {
            for link in &mut chain.links {
                let (mass, com) = (off(), off());
                link.body.mass *= mass;
                link.body.moment *= mass * com;
                link.body.inertia *= mass * com * com;
            }
        }
    }
    truth.joints.iter_mut().for_each(|j| j.rotor *= off());
}

/// Gives the robot its Coulomb and viscous friction, drawn where the configuration gives none.
fn base_friction(config: &FrictionConfig, scales: &Scales, truth: &mut TrueRobot, random: &mut Random) -> BaseFriction {
    let mut base = BaseFriction { fc: Vec::new(), fv: Vec::new() };
    for (i, joint) in truth.joints.iter_mut().enumerate() {
        // Drawn in any case, so that giving one list does not change what is drawn elsewhere.
        let coulomb = random.uniform(0.08, 0.16) * scales.torque[i];
        let viscous = random.uniform(0.1, 0.3) * scales.torque[i] / scales.limits.qd_max[i];
        let coulomb = config.f_c.get(i).copied().unwrap_or(coulomb);
        let viscous = config.f_v.get(i).copied().unwrap_or(viscous);
        let (coulomb, viscous) = if config.none { (0.0, 0.0) } else { (coulomb, viscous) };
        joint.friction = JointFriction::base(coulomb, viscous);
        base.fc.push(coulomb);
        base.fv.push(viscous);
    }
    base
}

/// Noise of one robot's sensors and drives.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Noise {
    /// On the logged torque, standard deviation [Nm].
    pub torque: Joints,
    /// Encoder step at the joint side [rad].
    pub encoder_step: Joints,
    /// Encoder noise [steps].
    pub encoder_steps: f64,
    /// Torque that truly acts [Nm].
    pub process: Joints,
    /// Spikes per second and joint.
    pub spikes_per_s: f64,
}

/// Encoder step at the joint side assumed where the robot file does not give resolution and gear ratio [rad]:
/// 20 bits behind a gear of 33.
const DEFAULT_STEP_RAD: f64 = 1.8e-7;

impl Noise {
    pub(crate) fn draw(
        robot: &RobotFile,
        config: &SimulationConfig,
        scales: &Scales,
        truth: &TrueRobot,
        random: &mut Random,
    ) -> Self {
        let mut noise = Self {
            torque: Joints::default(),
            encoder_step: Joints::default(),
            encoder_steps: config.noise.encoder_steps,
            process: scales.torque.map(|t| t * config.noise.process_share),
            spikes_per_s: config.noise.spikes_per_s,
        };
        let share = random.uniform(0.0025, 0.005);
        for (i, joint) in truth.joints.iter().enumerate() {
            noise.torque[i] = config.noise.torque_nm.get(i).copied().unwrap_or(share * scales.torque[i]);
            let bits = robot.drive.encoder_bits.as_ref().and_then(|b| b.get(i));
            let step = match (bits, &robot.drive.gear_ratio) {
                (Some(bits), Some(_)) => std::f64::consts::TAU / bits.exp2() / joint.gear.abs(),
                _ => DEFAULT_STEP_RAD,
            };
            noise.encoder_step[i] = config.noise.encoder_step_rad.unwrap_or(step);
        }
        noise
    }

    /// The same encoder without any noise.
    fn silenced(&self) -> Self {
        Self {
            torque: Joints::default(),
            encoder_step: self.encoder_step,
            encoder_steps: 0.0,
            process: Joints::default(),
            spikes_per_s: 0.0,
        }
    }
}
