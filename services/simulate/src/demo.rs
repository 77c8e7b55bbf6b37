//! A D3-1200-class Delta whose paper model is as wrong as in the paper: the real robot has forearms with
//! distributed mass, rotors that the model leaves out, and friction. The recordings are those of the
//! paper's section 6: free motions that stress the robot, and pick-and-place with 3.8 kg.

use crate::config::{FrictionConfig, SimulationConfig, TrajectoryGroup};
use crate::effects::TrueEffect;
use crate::reference::Kinds;
use crate::simulation::{Simulation, simulate};
use lacuna_interfaces::{BadInput, Recording, RobotFile};

/// Payload of the paper's pick-and-place trajectory [kg].
pub const DEMO_PAYLOAD_KG: f64 = 3.8;

/// Robot file of the demo: nominal values of the paper's model M_KH.
pub const DEMO_ROBOT: &str = r#"# Delta robot, nominal model (the paper's M_KH, corrected: theta > 0 lowers the elbow, z up, r = ra - rb)
kind = "delta"
name = "D3-1200-class"

[geometry]
l1 = 0.35
l2 = 0.88
ra = 0.2
rb = 0.05
alpha_deg = [0.0, 120.0, 240.0]

[mass]
platform = 1.1
upper_arm = 1.8          # uniform rod
forearm_point = 0.22     # point mass at the elbow and the same again at the platform, per leg
rotor_inertia = 0.06     # per joint, at the joint side

[env]
gravity = [0.0, 0.0, -9.81]

[drive]
gear_ratio = 33
encoder_bits = 20        # motor side
sample_rate_hz = 1000
"#;

/// The demo's recordings.
#[derive(Debug, Clone)]
pub struct Demo {
    /// Robot file, parsed from [`DEMO_ROBOT`].
    pub robot: RobotFile,
    /// Twelve free motions, for identification, and a thirteenth, v_F, that none of them repeats.
    pub free: Simulation,
    /// v_P: pick-and-place with [`DEMO_PAYLOAD_KG`], picked and placed several times; one recording, events in
    /// its truth.
    pub pick_place: Simulation,
}

impl Demo {
    /// v_F, the free motion kept for testing.
    pub fn test_motion(&self) -> Option<&Recording> {
        self.free.recordings.last()
    }

    /// The free motions to identify from.
    pub fn training_motions(&self) -> &[Recording] {
        self.free.recordings.split_last().map_or(&[], |(_, rest)| rest)
    }
}

/// Free motions for identification.
const TRAINING: u32 = 12;

/// Makes the demo's recordings: 1 kHz, 8 s each (v_P 10 s).
///
/// # Errors
/// None is known for this robot; [`BadInput`] is passed on if the simulation returns one.
pub fn demo_delta(seed: u64) -> Result<Demo, BadInput> {
    let robot = RobotFile::parse(DEMO_ROBOT)?;
    let group = |kind, count, duration_s, intensity| TrajectoryGroup { kind, duration_s, count, intensity };
    let truth = vec![
        // Uniform rods of 0.55 kg, centre of mass at 0.48 of their length: m_f = 0.44 + 0.11.
        TrueEffect::new("forearm_rod", &[], &[("ds_1", 0.044), ("ds_2", -0.047_446_7), ("dm", 0.11)]),
        TrueEffect::new("rotor_inertia", &["q1"], &[("J", 0.30)]),
        TrueEffect::new("rotor_inertia", &["q2"], &[("J", 0.32)]),
        TrueEffect::new("rotor_inertia", &["q3"], &[("J", 0.28)]),
    ];
    let free = SimulationConfig {
        seed,
        mass_error: 0.03,
        trajectories: vec![
            group(Kinds::PointToPoint, TRAINING / 2, 8.0, 1.0),
            group(Kinds::Fourier, TRAINING - TRAINING / 2, 8.0, 1.0),
            group(Kinds::PointToPoint, 1, 8.0, 1.0),
        ],
        friction: FrictionConfig { none: false, f_c: vec![5.2, 4.6, 4.9], f_v: vec![0.95, 0.8, 0.9] },
        effects: truth.clone(),
        ..SimulationConfig::default()
    };
    let mut carried = free.clone();
    carried.trajectories = vec![group(Kinds::PickPlace, 1, 10.0, 0.8)];
    carried.effects.push(TrueEffect::new("payload", &[], &[("m", DEMO_PAYLOAD_KG)]));
    // The same robot: friction, masses and noise are drawn from the same stream of the same seed.
    Ok(Demo { free: simulate(&robot, None, &free)?, pick_place: simulate(&robot, None, &carried)?, robot })
}
