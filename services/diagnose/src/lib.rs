//! Finds the physics that a robot's model leaves out: locates the mismatch, names it, models it, proves it on
//! recordings it was not fitted to.
//!
//! [`diagnose`] takes recordings in memory and returns [`Outcome`]; nothing here touches files or clocks.

pub mod base;
pub mod boost;
pub mod calibration;
pub mod context;
pub mod events;
pub mod families;
pub mod findings;
pub mod gram;
mod intervals;
mod locate;
pub mod model;
mod model_file;
mod polish;
pub mod rank;
pub mod refine;
mod report;
pub mod scene;
pub mod screen;
pub mod search;
pub mod select;
pub mod swap;
pub mod swung;
pub mod tolerance;
pub mod unknown;
mod words;

use base::Base;
use calibration::{Calibration, Evidence};
pub use findings::Findings;
use lacuna_interfaces::{BadInput, ModelFile, Recording, RobotFile};
pub use scene::Conditioning;
use scene::Scene;
use search::{Limits, Search};
use select::Seed;

/// What is to be diagnosed.
#[derive(Debug, Clone)]
pub struct Options {
    /// The robot file.
    pub robot: RobotFile,
    /// Text of the URDF it names.
    pub urdf: Option<String>,
    /// Recordings of the robot.
    pub recordings: Vec<Recording>,
    /// Recordings of the user's simulator on the same references; empty: the robot file is the simulation.
    pub sim: Vec<Recording>,
    /// Band, moving threshold, start times.
    pub conditioning: Conditioning,
    /// Seed of everything drawn.
    pub seed: u64,
}

/// What was found.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// The findings.
    pub findings: Findings,
    /// The model with the new terms.
    pub model: ModelFile,
    /// Named effects with what speaks for them.
    pub proof: Vec<(&'static str, Evidence)>,
    /// Families that were not taken, with what their best candidate gains in the end, less the price of its
    /// numbers [nats].
    pub nulls: Vec<(String, f64)>,
}

/// Diagnoses a robot. `progress` is told the share done and what is being done.
///
/// # Errors
/// [`BadInput`] if robot file or recordings cannot be used.
pub fn diagnose(options: &Options, progress: &mut dyn FnMut(f64, &str)) -> Result<Outcome, BadInput> {
    diagnose_with(options, &Calibration::built_in()?, progress)
}

/// As [`diagnose`], with thresholds, probabilities and intervals of another calibration.
///
/// # Errors
/// As [`diagnose`].
pub fn diagnose_with(
    options: &Options,
    calibration: &Calibration,
    progress: &mut dyn FnMut(f64, &str),
) -> Result<Outcome, BadInput> {
    if !options.sim.is_empty() {
        // Refused rather than ignored: a comparison of two sets of recordings is not built yet.
        return Err(BadInput::new(
            "sim: found recordings of a simulator; expected none, this comparison is not available",
        ));
    }
    progress(0.0, "conditioning the recordings");
    let mut scene = Scene::new(&options.robot, options.urdf.as_deref(), &options.recordings, &options.conditioning)?;
    let families = families::all();
    let unusable = || BadInput::new("recordings: the regression is singular; expected recordings with more motion");
    let mut seeds: Vec<Seed> = Vec::new();
    // What is found may say that some stretches must not count; then the search is run again without them.
    for last in [false, false, true] {
        progress(0.1, "fitting the base");
        let base = choose_base(&scene);
        let noise_nm = report::noise_floor(&scene);
        let floor_nm = floor(&scene, &base, &noise_nm);
        let limits = Limits {
            entry: families.iter().map(|f| calibration.entry_of(&f.key())).collect(),
            column: 6.0,
            floor_nm,
            noise_nm,
            most: 10,
        };
        let search = Search::new(&scene, &families, base.target.clone(), limits);
        let selection = search.select(&base, &seeds, progress).ok_or_else(unusable)?;
        if selection.blank.is_empty() || last {
            let material = report::Material {
                scene: &scene,
                base: &base,
                search: &search,
                selection: &selection,
                calibration,
                seed: options.seed,
            };
            return report::outcome(&material, progress).ok_or_else(unusable);
        }
        seeds = selection
            .model
            .atoms
            .iter()
            .filter(|a| families[a.family].driven || !a.carries.is_empty())
            .map(|a| Seed { family: a.family, joint: a.joint, shape: a.shape.clone(), carries: a.carries.clone() })
            .collect();
        let blank = selection.blank.clone();
        progress(0.1, &format!("again without {} stretches", blank.len()));
        drop(selection);
        drop(search);
        scene.blank(&blank);
    }
    Err(unusable())
}

/// Largest relative error at which a robot file's masses are taken for the base.
const NOMINAL_ERROR: f64 = 0.3;

/// The robot file's masses as the base where they are given and fit; otherwise a freely fitted base.
fn choose_base(scene: &Scene) -> Base {
    let delta = scene.body.as_delta().is_some();
    let nominal = (delta || scene.pi.iter().any(|v| *v != 0.0)).then(|| Base::nominal(scene));
    match nominal {
        Some(base) if delta || base.relative_error(scene) < NOMINAL_ERROR => base,
        _ => Base::free(scene),
    }
}

/// Smallest torque that counts as a finding, per joint [Nm]: a share of the noise in the band and of the
/// torque's size.
fn floor(scene: &Scene, base: &Base, noise: &[f64]) -> Vec<f64> {
    (0..scene.joints)
        .map(|j| {
            let count = scene.mask[j].iter().filter(|m| **m).count().max(1) as f64;
            let size = (base.torque.part[j].iter().map(|v| v * v).sum::<f64>() / count).sqrt();
            (0.4 * noise[j]).max(0.0015 * size)
        })
        .collect()
}
