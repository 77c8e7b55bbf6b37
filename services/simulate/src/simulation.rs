//! From a configuration to recordings and their truth.

use crate::config::{FrictionConfig, SimulationConfig};
use crate::effects::{self, Class, Scales, TrueEffect};
use crate::output::{Manifest, ManifestFile, recording_of};
use crate::plant::friction::JointFriction;
use crate::plant::robot::TipEvent;
use crate::plant::{Mechanism, TrueRobot};
use crate::random::Random;
use crate::reference::{self, MotionLimits, Reference};
use crate::run::{Logged, Setup, run};
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

/// Streams of the seed; trajectories take `TRAJECTORY` and on.
mod stream {
    pub const ROBOT: u64 = 0;
    pub const EFFECTS: u64 = 1;
    pub const PAUSES: u64 = 2;
    pub const REFERENCES: u64 = 1 << 20;
    pub const TRAJECTORY: u64 = 1 << 21;
}

/// Simulates closed-loop recordings of `robot`; `urdf` is the text of the URDF that the robot file names.
/// The same input gives the same recordings to the last bit, on any number of threads.
///
/// # Errors
/// [`BadInput`] if configuration and robot do not fit, or the robot cannot follow (workspace, inertia).
pub fn simulate(robot: &RobotFile, urdf: Option<&str>, config: &SimulationConfig) -> Result<Simulation, BadInput> {
    config.validate(robot)?;
    let nominal = TrueRobot::nominal(robot, urdf)?;
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
    simulate_plans(robot, &nominal, config, &plans)
}

/// Simulates given trajectories.
pub(crate) fn simulate_plans(
    robot: &RobotFile,
    nominal: &TrueRobot,
    config: &SimulationConfig,
    plans: &[Plan],
) -> Result<Simulation, BadInput> {
    let scales = Scales::of(robot, nominal)?;
    let mut random = Random::new(config.seed, stream::ROBOT);
    let mut truth = nominal.clone();
    perturb(&mut truth, config.mass_error, &mut random);
    let base = base_friction(&config.friction, &scales, &mut truth, &mut random);
    let noise = draw_noise(robot, config, &scales, &truth, &mut random);
    let mut events: Vec<Vec<TipEvent>> = vec![Vec::new(); plans.len()];
    let spans: Vec<(f64, Vec<(f64, f64)>)> =
        plans.iter().map(|p| (p.duration_s, p.reference.grips().to_vec())).collect();
    let mut drawn = Random::new(config.seed, stream::EFFECTS);
    effects::apply(&config.effects, robot, &mut truth, &mut events, &spans, &scales, &mut drawn)?;
    let setup = Setup {
        robot,
        truth: &truth,
        nominal,
        control: config.control,
        divider: config.log_divider(robot)?,
        torque_noise: noise.torque,
        encoder_step: noise.encoder_step,
        encoder_noise: config.noise.encoder_steps,
        process_noise: scales.torque.map(|t| t * config.noise.process_share),
        spikes_per_s: config.noise.spikes_per_s,
    };
    let runs: Vec<(Logged, Recording)> = plans
        .par_iter()
        .zip(&events)
        .enumerate()
        .map(|(k, (plan, events))| {
            let mut random = Random::new(config.seed, stream::TRAJECTORY + k as u64);
            let reference = plan.reference.as_ref();
            let logged = run(&setup, reference, events, plan.duration_s, plan.start_s, &mut random)?;
            let recording = recording_of(robot, &logged, k, config.log.temperature, plan.start_s, &mut random);
            Ok((logged, recording))
        })
        .collect::<Result<_, BadInput>>()?;
    let (behind, recordings): (Vec<_>, Vec<_>) = runs.into_iter().unzip();
    let files = recordings.iter().zip(plans);
    let manifest = Manifest {
        files: files
            .map(|(r, p)| ManifestFile {
                file: r.name.clone(),
                start_time_s: (p.start_s * 1e3).round() / 1e3,
                duration_s: p.duration_s,
            })
            .collect(),
        note: Manifest::NOTE.to_owned(),
    };
    let n = robot.joint_count();
    let truth = Truth {
        schema: Truth::SCHEMA.to_owned(),
        robot: robot.name.clone(),
        seed: config.seed,
        mass_error: config.mass_error,
        base: if config.friction.none { "ideal" } else { "friction" }.to_owned(),
        base_params: base,
        effects: config.effects.iter().map(|e| effect_truth(e, robot)).collect::<Result<_, _>>()?,
        events: recordings.iter().zip(&events).map(|(r, e)| (r.name.clone(), EventTruth::of(e))).collect(),
        noise: NoiseTruth {
            torque_nm: noise.torque[..n].to_vec(),
            encoder_step_rad: noise.encoder_step[..n].to_vec(),
            encoder_steps: config.noise.encoder_steps,
        },
        hidden_rms_nm: (0..n).map(|i| pooled_rms(behind.iter().map(|l| l.hidden_nm[i].as_slice()))).collect(),
        tracking_error_rad: behind.iter().map(|l| l.tracking_error_rad).fold(0.0, f64::max),
    };
    Ok(Simulation { recordings, manifest, truth, behind })
}

fn effect_truth(effect: &TrueEffect, robot: &RobotFile) -> Result<EffectTruth, BadInput> {
    let kind = effects::find(&effect.id)?;
    let all = kind.scope == effects::Scope::Joint && effect.joints.is_empty();
    Ok(EffectTruth {
        id: effect.id.clone(),
        cls: kind.class,
        also_accept: kind.also_accept.iter().map(|s| (*s).to_owned()).collect(),
        joints: if all { robot.joints.clone() } else { effect.joints.clone() },
        params: effect.params.clone(),
        law: kind.law.to_owned(),
    })
}

impl EffectTruth {
    /// True if a diagnosis can name it.
    pub fn in_catalogue(&self) -> bool {
        self.cls == Class::Catalogue
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
                let mass = off();
                link.body.mass *= mass;
                link.body.inertia *= mass;
                link.body.com *= off();
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

struct Noise {
    torque: Joints,
    encoder_step: Joints,
}

/// Encoder assumed where the robot file gives no resolution [bit], motor side.
const DEFAULT_BITS: f64 = 20.0;

fn draw_noise(
    robot: &RobotFile,
    config: &SimulationConfig,
    scales: &Scales,
    truth: &TrueRobot,
    random: &mut Random,
) -> Noise {
    let mut noise = Noise { torque: Joints::default(), encoder_step: Joints::default() };
    let share = random.uniform(0.0025, 0.005);
    for (i, joint) in truth.joints.iter().enumerate() {
        noise.torque[i] = config.noise.torque_nm.get(i).copied().unwrap_or(share * scales.torque[i]);
        let bits = robot.drive.encoder_bits.as_ref().and_then(|b| b.get(i)).unwrap_or(DEFAULT_BITS);
        let step = std::f64::consts::TAU / bits.exp2() / joint.gear.abs();
        noise.encoder_step[i] = config.noise.encoder_step_rad.unwrap_or(step);
    }
    noise
}
