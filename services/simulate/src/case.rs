//! Random cases for proofs: a robot, trajectories, noise, and zero to three effects.

use crate::config::{SimulationConfig, TrajectoryGroup};
use crate::effects::{Class, Scales, TrueEffect, draw_effect, registry};
use crate::plant::TrueRobot;
use crate::random::Random;
use crate::reference::Kinds;
use lacuna_interfaces::robot::{
    DhRow, Drive, Env, Geometry, Kind, Limits, LinkInertia, Mass, PerJoint, RobotFile, Tolerance, TorqueUnit,
};
use lacuna_interfaces::{BadInput, MAX_JOINTS};
use serde::{Deserialize, Serialize};

/// Seeds from here on belong to the proof alone (`lacuna prove`): no development, calibration or test draws from them.
pub const PROOF_SEEDS_FROM: u64 = 1 << 40;

/// What kind of cases to draw.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CaseOptions {
    /// Kind of robot.
    pub kind: Kind,
    /// Number of effects.
    pub effects: usize,
    /// These ids first; further ones are drawn from the catalogue.
    pub ids: Vec<String>,
    /// Draw the last effect from those outside the catalogue.
    pub unknown: bool,
    /// Strength of effects, drawn log-uniformly from this range; 1 is usual.
    pub severity: [f64; 2],
    /// Real masses differ from the robot file's by up to this share.
    pub mass_error: f64,
    /// Trajectories per case.
    pub trajectories: u32,
    /// Duration of each [s].
    pub duration_s: f64,
    /// Say in the truth how much torque each effect is behind (one more simulation per effect).
    pub measure_effects: bool,
}

impl Default for CaseOptions {
    fn default() -> Self {
        Self {
            kind: Kind::Delta,
            effects: 1,
            ids: Vec::new(),
            unknown: false,
            severity: [0.5, 1.5],
            mass_error: 0.0,
            trajectories: 6,
            duration_s: 5.0,
            measure_effects: false,
        }
    }
}

/// A drawn case; [`crate::simulate`] makes its recordings.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Nominal robot: what the diagnosis may know.
    pub robot: RobotFile,
    /// What to simulate.
    pub config: SimulationConfig,
}

/// Effects that are a matter of course on any robot, or of no use on a random one.
const NOT_DRAWN: &[&str] = &["coulomb", "viscous"];

/// Pairs whose signals are the same: never both in one case, nor on one joint.
const ALIKE: &[&[&str]] = &[
    &["coulomb_asym", "torque_offset"],
    &["rotor_inertia", "arm_inertia", "gravity_spring"],
    &["elasticity", "backlash", "axis_coupling"],
    &["payload", "payload_ecc"],
    &["encoder_offset", "link_length"],
];

/// Draws a case.
///
/// # Errors
/// [`BadInput`] if an id is unknown, or the options ask for what this kind of robot cannot have.
pub fn draw_case(seed: u64, options: &CaseOptions) -> Result<Case, BadInput> {
    let [low, high] = options.severity;
    if !(low > 0.0 && high >= low && high.is_finite()) {
        return Err(BadInput::new(format!("severity: found [{low}, {high}]; expected two positive, rising numbers")));
    }
    let mut random = Random::new(seed, 7);
    let robot = draw_robot(options.kind, &mut random)?;
    let nominal = TrueRobot::nominal(&robot, None)?;
    let scales = Scales::of(&robot, &nominal)?;
    let mut effects: Vec<TrueEffect> = Vec::new();
    while effects.len() < options.effects.max(options.ids.len()) {
        let last = effects.len() + 1 == options.effects.max(options.ids.len());
        let id = match options.ids.get(effects.len()) {
            Some(id) => id.clone(),
            None => draw_id(options, last && options.unknown, &effects, &mut random)?,
        };
        let severity = random.uniform(low.ln(), high.ln()).exp();
        effects.push(draw_effect(&id, &robot, &scales, severity, &mut random)?);
    }
    let mut config = SimulationConfig {
        seed,
        mass_error: options.mass_error,
        trajectories: draw_trajectories(options, &mut random),
        effects,
        measure_effects: options.measure_effects,
        ..SimulationConfig::default()
    };
    // A coarser encoder has coarser steps, not more noise: what shakes it is about the same.
    let bits = robot.drive.encoder_bits.as_ref().and_then(|b| b.get(0)).unwrap_or(20.0);
    config.noise.encoder_steps = (random.uniform(1.5, 3.5) * (bits - 20.0).exp2()).max(0.3);
    // Temperature columns appear also where nothing depends on them.
    config.log.temperature = random.unit() < 0.5 || config.effects.iter().any(|e| e.id == "thermal_viscous");
    Ok(Case { robot, config })
}

fn draw_id(
    options: &CaseOptions,
    unknown: bool,
    taken: &[TrueEffect],
    random: &mut Random,
) -> Result<String, BadInput> {
    let clashes = |id: &str| {
        taken.iter().any(|t| t.id == id || ALIKE.iter().any(|g| g.contains(&id) && g.contains(&t.id.as_str())))
    };
    let class = if unknown { Class::Unknown } else { Class::Catalogue };
    let candidates: Vec<&str> = registry()
        .filter(|e| e.class == class && e.kind.is_none_or(|k| k == options.kind))
        .map(|e| e.id)
        .filter(|id| !NOT_DRAWN.contains(id) && !clashes(id))
        .collect();
    match candidates.get(random.index(candidates.len())) {
        Some(id) => Ok((*id).to_owned()),
        None => Err(BadInput::new(format!("effects: found {}; expected fewer, no further one fits", options.effects))),
    }
}

/// A mix of kinds; every case has a slow sweep and rest-to-rest moves if it has two trajectories.
fn draw_trajectories(options: &CaseOptions, random: &mut Random) -> Vec<TrajectoryGroup> {
    let first = [Kinds::PointToPoint, Kinds::Sweep, Kinds::Fourier, Kinds::PickPlace];
    (0..options.trajectories as usize)
        .map(|k| {
            let further = [Kinds::Fourier, Kinds::Fourier, Kinds::PointToPoint, Kinds::Chirp];
            let kind = first.get(k).copied().unwrap_or(further[random.index(further.len())]);
            TrajectoryGroup { kind, duration_s: options.duration_s, count: 1, intensity: random.uniform(0.5, 1.0) }
        })
        .collect()
}

/// Draws a nominal robot file.
///
/// # Errors
/// None is known; [`BadInput`] is passed on if the drawn file does not pass its own checks.
pub fn draw_robot(kind: Kind, random: &mut Random) -> Result<RobotFile, BadInput> {
    let robot = match kind {
        Kind::Delta => draw_delta(random),
        Kind::Serial => draw_serial(random),
    };
    robot.validate()?;
    Ok(robot)
}

/// Rounds to three significant digits, as data sheets do.
fn sheet(v: f64) -> f64 {
    if v == 0.0 {
        return 0.0;
    }
    let scale = 10f64.powi(2 - v.abs().log10().floor() as i32);
    (v * scale).round() / scale
}

fn empty(kind: Kind, name: &str, joints: Vec<String>) -> RobotFile {
    RobotFile {
        kind,
        name: name.to_owned(),
        joints,
        torque_unit: TorqueUnit::Nm,
        geometry: None,
        mass: None,
        urdf: None,
        dh: Vec::new(),
        link: Vec::new(),
        env: Env::default(),
        drive: Drive::default(),
        columns: Default::default(),
        limits: Limits::default(),
        tolerance: Tolerance::default(),
        ethercat: None,
    }
}

fn draw_delta(random: &mut Random) -> RobotFile {
    let mut robot = empty(Kind::Delta, "delta", ["q1", "q2", "q3"].map(str::to_owned).to_vec());
    let l1 = sheet(random.uniform(0.25, 0.42));
    let l2 = sheet(l1 * random.uniform(2.2, 2.7));
    let rb = sheet(l1 * random.uniform(0.12, 0.2));
    let size = (l1 / 0.35).powi(2) * random.uniform(0.7, 1.4);
    let first = sheet(random.uniform(0.0, 60.0));
    robot.geometry = Some(Geometry {
        l1,
        l2,
        ra: sheet(l1 * random.uniform(0.45, 0.65)),
        rb,
        alpha_deg: [first, first + 120.0, first + 240.0],
    });
    robot.mass = Some(Mass {
        platform: sheet(size * random.uniform(0.8, 1.4)),
        upper_arm: sheet(size * random.uniform(1.4, 2.4)),
        forearm_point: sheet(size * random.uniform(0.15, 0.3)),
        rotor_inertia: sheet(size * l1 * l1 * random.uniform(0.35, 0.8)),
    });
    robot.drive.gear_ratio = Some(PerJoint::All([25.0, 33.0, 40.0, 50.0][random.index(4)]));
    robot.drive.encoder_bits = Some(PerJoint::All([17.0, 18.0, 19.0, 20.0][random.index(4)]));
    robot.drive.sample_rate_hz = Some(1000.0);
    robot.limits.qd_max_rad_s = Some(PerJoint::All(9.0));
    robot.limits.qdd_max_rad_s2 = Some(PerJoint::All(110.0));
    robot
}

/// An arm of two to six joints whose links shrink outwards; axes alternate as on common arms.
fn draw_serial(random: &mut Random) -> RobotFile {
    let n = [2, 3, 4, 6][random.index(4)].min(MAX_JOINTS);
    let mut robot = empty(Kind::Serial, "arm", (1..=n).map(|i| format!("joint_{i}")).collect());
    let quarter = std::f64::consts::FRAC_PI_2;
    // (twist after the joint, is the length along the axis)
    let layout: &[(f64, bool)] = match n {
        2 => &[(0.0, false), (0.0, false)],
        3 => &[(quarter, true), (0.0, false), (0.0, false)],
        4 => &[(quarter, true), (0.0, false), (quarter, false), (0.0, true)],
        _ => &[(quarter, true), (0.0, false), (quarter, false), (-quarter, true), (quarter, false), (0.0, true)],
    };
    let reach = random.uniform(0.3, 0.5);
    let mass = random.uniform(4.0, 12.0);
    let (mut qd, mut qdd) = (Vec::new(), Vec::new());
    for (k, &(alpha, along)) in layout.iter().enumerate() {
        let shrink = 0.75f64.powi(k as i32);
        let length = sheet(reach * shrink * random.uniform(0.7, 1.1));
        let (a, d) = if along { (0.0, length) } else { (length, 0.0) };
        robot.dh.push(DhRow { a, d, alpha, offset: 0.0, joint: Default::default() });
        let m = mass * 0.62f64.powi(k as i32) * random.uniform(0.8, 1.2);
        let back = if along { [0.0, 0.0, -0.5 * length] } else { [-0.55 * length, 0.0, 0.0] };
        let (thin, long) = (0.006 * m * shrink, m * length * length / 11.0 + 0.006 * m * shrink);
        let inertia = if along { [long, 0.0, 0.0, long, 0.0, thin] } else { [thin, 0.0, 0.0, long, 0.0, long] };
        let side = 0.05 * length;
        robot.link.push(LinkInertia {
            mass: sheet(m),
            com: [
                sheet(back[0] + side * random.uniform(-1.0, 1.0)),
                sheet(side * random.uniform(-1.0, 1.0)),
                sheet(back[2] + side * random.uniform(-1.0, 1.0)),
            ],
            inertia: inertia.map(sheet),
            rotor_inertia: sheet(0.5 * mass * reach * reach * 0.4f64.powi(k as i32) * random.uniform(0.6, 1.2)),
        });
        qd.push(sheet(random.uniform(1.8, 3.0) / shrink));
        qdd.push(sheet(random.uniform(7.0, 14.0) / shrink));
    }
    if n == 2 {
        // A planar arm that swings: gravity in its plane.
        robot.env.gravity = [9.81, 0.0, 0.0];
    }
    robot.drive.gear_ratio = Some(PerJoint::All([50.0, 80.0, 100.0, 120.0][random.index(4)]));
    robot.drive.encoder_bits = Some(PerJoint::All([15.0, 17.0, 19.0][random.index(3)]));
    robot.drive.sample_rate_hz = Some([500.0, 1000.0][random.index(2)]);
    robot.limits.q_min_rad = Some(PerJoint::All(-1.4));
    robot.limits.q_max_rad = Some(PerJoint::All(1.4));
    robot.limits.qd_max_rad_s = Some(PerJoint::Each(qd));
    robot.limits.qdd_max_rad_s2 = Some(PerJoint::Each(qdd));
    robot
}

/// Ids that [`draw_case`] can draw for a kind of robot, with their class.
pub fn drawable(kind: Kind) -> Vec<(&'static str, Class)> {
    registry()
        .filter(|e| e.kind.is_none_or(|k| k == kind) && !NOT_DRAWN.contains(&e.id))
        .map(|e| (e.id, e.class))
        .collect()
}
