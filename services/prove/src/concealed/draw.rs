//! Which cases are drawn: every effect at random strength, on Delta robots and arms, alone and together, on robots
//! that are what their file says and on robots that are a little off.

use crate::error::Error;
use crate::seeds;
use lacuna_interfaces::RobotFile;
use lacuna_interfaces::robot::Kind;
use lacuna_simulate::case::drawable;
use lacuna_simulate::effects::Class as EffectClass;
use lacuna_simulate::random::Random;
use lacuna_simulate::{CaseOptions, Simulation, draw_case, simulate};

/// Strength of effects, log-uniform; 1 is usual.
pub const SEVERITY: [f64; 2] = [0.2, 2.0];

/// Number of the case that run time is measured on, beyond all others.
pub const TIMING_CASE: u64 = (1 << 15) - 1;

/// What kind of answer a case has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// Nothing hidden.
    Clean,
    /// One effect of the catalogue.
    Single,
    /// Two or three.
    Several,
    /// One outside the catalogue, alone or beside one of the catalogue.
    Outside,
}

/// Shares of the classes.
const SHARES: [(Class, f64); 4] =
    [(Class::Clean, 0.3), (Class::Single, 0.4), (Class::Several, 0.2), (Class::Outside, 0.1)];

/// What a case is to be.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Kind of answer.
    pub class: Class,
    /// Share by which the robot's masses differ from its file, which states as much.
    pub mass_error: f64,
    /// The robot file gives no masses, as those of most real arms do.
    pub bare: bool,
    options: CaseOptions,
}

/// A case with its answer.
#[derive(Debug)]
pub struct Drawn {
    /// What the diagnosis may know.
    pub robot: RobotFile,
    /// Recordings and truth.
    pub simulation: Simulation,
    /// Seeds that gave no case.
    pub redrawn: usize,
}

/// Effects that a freely fitted rigid body cannot take over, for robots whose file has no masses.
const BESIDE_FREE_BODY: [&str; 6] =
    ["stribeck", "viscous_power", "load_friction", "cogging", "presliding", "thermal_viscous"];

impl Plan {
    /// The robot is a Delta.
    pub fn is_delta(&self) -> bool {
        self.options.kind == Kind::Delta
    }

    /// In a few words.
    pub fn words(&self) -> String {
        let mut words = if self.is_delta() { "Delta" } else { "arm" }.to_owned();
        if self.bare {
            words += " without masses in its file";
        }
        if self.mass_error > 0.0 {
            words += &format!(", masses off by up to {:.1} %", 100.0 * self.mass_error);
        }
        words
    }

    /// The case that run time is measured on: two effects, 6 × 16 s.
    pub fn timing() -> Self {
        let options = CaseOptions { effects: 2, duration_s: 16.0, severity: [1.0, 1.0], ..CaseOptions::default() };
        Self { class: Class::Several, mass_error: 0.0, bare: false, options }
    }
}

/// Plans for `count` cases, in random order: a case's number tells nothing.
pub fn plans(count: usize, block: u64) -> Vec<Plan> {
    let mut random = Random::new(seeds::seed(block, 0, 0), 77);
    let mut left = parts(count);
    let mut list = Vec::new();
    let mut singles = [0usize; 2];
    for (class, number) in &mut left {
        for k in 0..*number {
            list.push(plan(*class, k, &mut singles, &mut random));
        }
    }
    // Fisher–Yates.
    for i in (1..list.len()).rev() {
        list.swap(i, random.index(i + 1));
    }
    list
}

/// How many of each class; they add up to `count`.
fn parts(count: usize) -> Vec<(Class, usize)> {
    let mut list: Vec<(Class, usize)> =
        SHARES.iter().map(|(class, share)| (*class, (share * count as f64).floor() as usize)).collect();
    let rest = |k: usize| (SHARES[k].1 * count as f64).fract();
    let mut order: Vec<usize> = (0..SHARES.len()).collect();
    order.sort_by(|a, b| rest(*b).total_cmp(&rest(*a)));
    let missing = count - list.iter().map(|l| l.1).sum::<usize>();
    for k in order.into_iter().cycle().take(missing) {
        list[k].1 += 1;
    }
    list
}

fn plan(class: Class, k: usize, singles: &mut [usize; 2], random: &mut Random) -> Plan {
    // Two robots of five are arms, and a few of those have a file without masses.
    let kind = if matches!(k % 5, 1 | 4) { Kind::Serial } else { Kind::Delta };
    let bare = k % 15 == 4 && matches!(class, Class::Clean | Class::Single);
    let mut ids = Vec::new();
    if class == Class::Single {
        // Every effect in turn, so that each class is seen.
        let turn = &mut singles[usize::from(kind == Kind::Serial)];
        ids.push(if bare { BESIDE_FREE_BODY[k / 15 % BESIDE_FREE_BODY.len()].to_owned() } else { nth(kind, *turn) });
        *turn += usize::from(!bare);
    }
    let effects = match class {
        Class::Clean => 0,
        Class::Single => 1,
        Class::Several => 2 + random.index(2),
        Class::Outside => 1 + k % 2,
    };
    // Half of the robots are a little off, by no more than their file says.
    let declared = if k % 2 == 1 { [0.01, 0.02, 0.03][random.index(3)] } else { 0.0 };
    let options = CaseOptions {
        kind,
        effects,
        ids,
        unknown: class == Class::Outside,
        severity: SEVERITY,
        mass_error: perturbation(kind, declared),
        measure_effects: true,
        ..CaseOptions::default()
    };
    Plan { class, mass_error: declared, bare, options }
}

/// A chain's inertias go with mass and twice with the centre of mass, all of which are drawn: a third each.
fn perturbation(kind: Kind, declared: f64) -> f64 {
    if kind == Kind::Serial { declared / 3.0 } else { declared }
}

fn nth(kind: Kind, k: usize) -> String {
    let ids: Vec<&str> =
        drawable(kind).into_iter().filter(|(_, class)| *class == EffectClass::Catalogue).map(|(id, _)| id).collect();
    ids.get(k % ids.len().max(1)).copied().unwrap_or_default().to_owned()
}

/// Draws the case of a plan.
///
/// # Errors
/// If none of [`seeds::ATTEMPTS`] seeds gives a robot that can follow its motion.
pub fn case(plan: &Plan, block: u64, number: u64) -> Result<Drawn, Error> {
    let mut why = String::new();
    for attempt in 0..seeds::ATTEMPTS {
        let made = draw_case(seeds::seed(block, number, attempt), &plan.options)
            .and_then(|case| Ok((simulate(&case.robot, None, &case.config)?, case.robot)));
        match made {
            Ok((simulation, mut robot)) => {
                robot.tolerance.mass = robot.tolerance.mass.max(plan.mass_error);
                if plan.bare {
                    robot.link.clear();
                }
                return Ok(Drawn { robot, simulation, redrawn: attempt as usize });
            }
            Err(e) => why = e.to_string(),
        }
    }
    Err(Error::Run(format!("case {}: none of {} seeds gave a case: {why}", number + 1, seeds::ATTEMPTS)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_add_up_and_the_full_proof_has_enough_clean_cases() {
        for count in [1, 2, 4, 7, 12, 200, 220] {
            let list = plans(count, 0);
            assert_eq!(list.len(), count);
        }
        let full = plans(super::super::CASES, 0);
        let clean = full.iter().filter(|p| p.class == Class::Clean).count();
        assert!(full.len() >= 200 && clean >= 60, "{clean} of {}", full.len());
        assert!(full.iter().any(|p| p.bare) && full.iter().any(|p| p.mass_error > 0.0));
        // Every effect that the simulator can conceal is concealed alone at least once.
        for kind in [Kind::Delta, Kind::Serial] {
            for (id, class) in drawable(kind).into_iter().filter(|d| d.1 == EffectClass::Catalogue) {
                let alone = |p: &&Plan| p.options.ids == [id] && p.class == Class::Single;
                let found = full.iter().find(alone);
                assert!(found.is_some(), "{id} {class:?}");
            }
        }
    }

    #[test]
    fn the_order_tells_nothing_and_the_seed_decides() {
        let classes = |block| plans(40, block).iter().map(|p| p.class).collect::<Vec<_>>();
        assert_eq!(classes(0), classes(0));
        assert_ne!(classes(0), classes(1));
        let first: Vec<Class> = classes(0)[..12].to_vec();
        assert!(first.iter().any(|c| *c != Class::Clean), "clean cases are not all at the start");
    }

    #[test]
    fn a_case_is_drawn_again_if_the_robot_cannot_follow_and_the_file_hides_the_answer() {
        let plan = Plan { bare: true, ..plans(60, 3).into_iter().find(|p| !p.is_delta()).unwrap() };
        let short = Plan { options: CaseOptions { duration_s: 1.0, trajectories: 2, ..plan.options.clone() }, ..plan };
        let drawn = case(&short, 3, 5).unwrap();
        assert!(drawn.robot.link.is_empty(), "no masses in the file");
        assert_eq!(drawn.simulation.recordings.len(), 2);
        let again = case(&short, 3, 5).unwrap();
        assert_eq!(drawn.simulation.recordings, again.simulation.recordings);
        let impossible =
            Plan { options: CaseOptions { ids: vec!["forearm_rod".to_owned()], ..short.options.clone() }, ..short };
        assert!(case(&impossible, 3, 5).unwrap_err().to_string().contains("none of 32 seeds"));
    }
}
