//! What a good tool finds in each robot's recordings, from independent fits and from what the makers published.

use crate::section::short;
use lacuna_interfaces::RobotFile;

/// One expected answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Expected {
    /// This effect on all these joints (none: anywhere), with at least this held-out reduction.
    Named { effect: &'static str, joints: &'static [&'static str], gain: Option<f64> },
    /// Ripple at these orders per motor turn; on each of these joints, or on any.
    Orders { joints: &'static [&'static str], orders: &'static [f64] },
    /// Not this effect.
    Absent { effect: &'static str },
    /// Held-out error relative to the torque.
    Error { most: f64 },
    /// A stiffness, within 30 % of what two encoders measure directly [Nm/rad].
    Stiffness { joint: &'static str, k: f64 },
    /// The effect's gain differs from recording to recording, and the tool says so.
    NotUniform { effect: &'static str },
}

impl Expected {
    /// In words.
    pub fn words(&self, robot: &RobotFile) -> String {
        let on = |joints: &[&str]| if joints.is_empty() { String::new() } else { format!(" ({})", joints.join(", ")) };
        match self {
            Self::Named { effect, joints, gain: None } => format!("{effect}{}", on(joints)),
            Self::Named { effect, joints, gain: Some(g) } => {
                format!("{effect}{}, −{:.0} % or more", on(joints), 100.0 * g)
            }
            Self::Orders { joints, orders } => {
                let list: Vec<String> = orders.iter().map(|o| short(*o, 3)).collect();
                format!("cogging at orders {} per motor turn{}", list.join(", "), on(joints))
            }
            Self::Absent { effect } => format!("not {effect}"),
            Self::Error { most } => {
                format!("error at most {:.1} % of the torque signal [{}]", 100.0 * most, robot.torque_unit.symbol())
            }
            Self::Stiffness { joint, k } => format!("elasticity ({joint}), {} Nm/rad by two encoders", short(*k, 2)),
            Self::NotUniform { effect } => format!("{effect} called not uniform"),
        }
    }
}

/// A robot with its recordings.
#[derive(Debug)]
pub struct Robot {
    /// Folder.
    pub folder: &'static str,
    /// Recordings.
    pub files: &'static [&'static str],
    /// What is expected.
    pub expected: &'static [Expected],
}

use Expected::{Absent, Error, Named, NotUniform, Orders, Stiffness};

/// The robots.
pub const ROBOTS: &[Robot] = &[
    Robot {
        folder: "dfki_double_pendulum",
        files: &["design_A.0_20220812_20220812-061157-PM_measured.csv"],
        expected: &[
            Named { effect: "load_friction", joints: &[], gain: Some(0.19) },
            // 126 and 252 rad⁻¹ behind a gear of 6: 21 and 42 per motor turn.
            Orders { joints: &[], orders: &[21.0, 42.0] },
            Absent { effect: "stribeck" },
            Absent { effect: "coulomb_asym" },
            Absent { effect: "presliding" },
            Error { most: 0.061 },
        ],
    },
    Robot {
        folder: "staubli_tx40",
        files: &["tx40_traj.csv"],
        expected: &[
            Named { effect: "axis_coupling", joints: &["joint_5", "joint_6"], gain: None },
            Error { most: 0.177 },
        ],
    },
    Robot {
        folder: "odrive_cogging",
        files: &["slow2_nocomp_0.csv", "slow2_nocomp_1.csv", "slow2_nocomp_2.csv"],
        expected: &[Orders { joints: &[], orders: &[7.0, 12.0, 14.0, 28.0, 36.0, 84.0] }, Error { most: 0.156 }],
    },
    Robot {
        folder: "bam_xl330",
        files: &[
            "xl330_kp100_lift_and_drop_10h28m17.csv",
            "xl330_kp100_sin_sin_10h28m10.csv",
            "xl330_kp100_sin_time_square_10h28m32.csv",
            "xl330_kp100_up_and_down_10h28m24.csv",
            "xl330_kp200_lift_and_drop_10h28m49.csv",
            "xl330_kp200_sin_sin_10h28m42.csv",
            "xl330_kp200_sin_time_square_10h29m04.csv",
            "xl330_kp200_up_and_down_10h28m57.csv",
            "xl330_kp400_lift_and_drop_10h29m21.csv",
            "xl330_kp400_sin_sin_10h29m14.csv",
            "xl330_kp400_sin_time_square_10h29m37.csv",
            "xl330_kp400_up_and_down_10h29m29.csv",
            "xl330_kp800_lift_and_drop_10h29m54.csv",
            "xl330_kp800_sin_sin_10h29m47.csv",
            "xl330_kp800_sin_time_square_10h30m10.csv",
            "xl330_kp800_up_and_down_10h30m02.csv",
        ],
        expected: &[
            Named { effect: "load_friction", joints: &[], gain: Some(0.14) },
            Named { effect: "thermal_viscous", joints: &[], gain: None },
        ],
    },
    Robot {
        folder: "kuka_kr300",
        files: &["traj_A.csv", "traj_B.csv", "traj_C.csv"],
        expected: &[
            Stiffness { joint: "A1", k: 1.7e6 },
            Stiffness { joint: "A2", k: 2.9e6 },
            Stiffness { joint: "A3", k: 2.3e6 },
            Orders { joints: &["A1", "A3"], orders: &[8.0] },
            NotUniform { effect: "load_friction" },
            Error { most: 0.074 },
        ],
    },
    Robot {
        folder: "kinova_gen3",
        files: &["RunTrajectory1.csv", "opti_traj_testing1.csv", "opti_traj_testing2.csv"],
        expected: &[
            Named { effect: "load_friction", joints: &["joint_2"], gain: None },
            Named { effect: "kt_scale", joints: &["joint_4"], gain: None },
        ],
    },
];
