//! Torque ripple that repeats with the motor's angle.

use crate::effects::kernel::joint_law;
use crate::effects::specification::ANY;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};
use lacuna_interfaces::RobotFile;

pub(super) static EFFECT: Effect = Effect {
    id: "cogging",
    title: "Cogging and gear ripple",
    law: "a_s sin(h N θ) + a_c cos(h N θ)",
    words: "Magnets and teeth, current offsets (order = pole pairs), gear teeth and the two waves a turn of a \
            harmonic drive give a torque of order h per motor revolution; N is the gear ratio of the robot file (1 \
            if it gives none: then h counts per joint revolution). One term per order.",
    reference: "Piccoli, Yim 2016, Int. J. Robotics Research 35, 148-160; Taghirad, Bélanger 1998, J. Dyn. Syst. \
                Meas. Control 120(4)",
    parameters: &[
        ParameterSpec::amplitude("a_s", "Nm", "sine amplitude", ANY, 0.4).or(0.0),
        ParameterSpec::amplitude("a_c", "Nm", "cosine amplitude", ANY, 0.3).or(0.0),
        ParameterSpec::shape("h", "1/rev", "order per motor revolution", (1e-3, 1e4), 2.0)
            .searched(&[1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0]),
    ],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Transmission,
    stage: OwningStage::Friction,
    dissipative: false,
    exact_group: &[],
    practical_group: &[],
    appears: &[Regime::SlowSliding, Regime::Rest],
    vanishes: &[],
    build: |request| {
        let h = request.shape("h");
        let context = request.context;
        let order: Vec<f64> = (0..context.joint_count()).map(|j| h * context.gear_ratio(j)).collect();
        Ok(joint_law(request.joints, move |s, j| {
            let (sin, cos) = (order.get(j).copied().unwrap_or(0.0) * s.q_rad[j]).sin_cos();
            [sin, cos]
        }))
    },
};

/// Orders per motor revolution that a joint's motor and gear suggest, increasing: 1 to 8 (eccentricity, gear,
/// harmonic drive), multiples of pole pairs and slots, and the least common multiple of poles and slots.
pub fn candidate_orders(robot: &RobotFile, joint: usize) -> Vec<f64> {
    let whole = |value: &Option<lacuna_interfaces::robot::PerJoint>| -> Option<u64> {
        value.as_ref().and_then(|v| v.get(joint)).map(f64::round).filter(|v| (1.0..=1e3).contains(v)).map(|v| v as u64)
    };
    let (pairs, slots) = (whole(&robot.drive.pole_pairs), whole(&robot.drive.slots));
    let mut orders: Vec<u64> = (1..=8).collect();
    if let Some(p) = pairs {
        orders.extend([p, 2 * p, 3 * p, 4 * p, 6 * p, 12 * p]);
    }
    if let Some(s) = slots {
        orders.extend([s, 2 * s, 3 * s]);
    }
    if let (Some(p), Some(s)) = (pairs, slots) {
        let (mut a, mut b) = (2 * p, s);
        while b > 0 {
            (a, b) = (b, a % b);
        }
        orders.push(2 * p / a * s);
    }
    orders.sort_unstable();
    orders.dedup();
    orders.into_iter().map(|o| o as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_of_a_bare_motor() {
        // 7 pole pairs and 12 slots: a published anticogging map shows 7, 12, 14, 28, 36 and 84.
        let text =
            "kind = \"serial\"\nname = \"m\"\njoints = [\"m\"]\n[[dh]]\na = 0.0\n[drive]\npole_pairs = 7\nslots = 12\n";
        let orders = candidate_orders(&RobotFile::parse(text).unwrap(), 0);
        for o in [1.0, 2.0, 7.0, 12.0, 14.0, 28.0, 36.0, 84.0] {
            assert!(orders.contains(&o), "{o} in {orders:?}");
        }
        assert!(orders.windows(2).all(|w| w[0] < w[1]));
    }
}
