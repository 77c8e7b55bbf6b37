//! Finds the physics that a robot's model leaves out: locates the mismatch, names it, models it, proves it on
//! recordings it was not fitted to.
//!
//! [`diagnose`] takes recordings in memory and returns [`Outcome`]; nothing here touches files or clocks.

pub mod base;
pub mod boost;
pub mod calibration;
mod check;
pub mod context;
mod deflection;
pub mod events;
pub mod evidence;
mod expression;
pub mod families;
pub mod findings;
pub mod forward;
pub mod gram;
mod held;
mod intervals;
mod locate;
pub mod model;
mod model_file;
mod next;
mod polish;
mod proof;
pub mod rank;
pub mod refine;
mod region;
mod report;
pub mod ripple;
mod rival;
pub mod scene;
pub mod screen;
pub mod search;
pub mod select;
mod sharpen;
mod sim;
pub mod split;
pub mod swap;
pub mod swung;
pub mod tolerance;
mod transfer;
mod transmission;
pub mod unknown;
pub mod whiten;
mod words;

use base::Base;
use calibration::Calibration;
pub use evidence::Evidence;
use families::Family;
pub use findings::Findings;
use lacuna_interfaces::{BadInput, ModelFile, Recording, RobotFile};
pub use scene::Conditioning;
use scene::{Column, Raw, Scene};
use search::{Limits, Search};
use select::{Seed, Selection};
use sim::Simulator;
use split::Set;
pub use split::{Holdout, Span, Split};
use transfer::Fitted;

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
    /// Band, moving threshold, start times, split.
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
    pub proof: Vec<(&'static str, calibration::Evidence)>,
    /// Families that were not taken, with what their best candidate gains in the end, less the price of its
    /// numbers [nats].
    pub nulls: Vec<(String, f64)>,
    /// What a report shows beside them.
    pub evidence: Evidence,
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
    if !options.sim.is_empty() && !options.robot.columns.link_torque.is_empty() {
        // A simulator is compared by the torque of its motors; sensors behind the gears are no part of that.
        let mut plain = options.clone();
        plain.robot.columns.link_torque.clear();
        return diagnose_with(&plain, calibration, progress);
    }
    progress(0.0, "conditioning the recordings");
    check::recordings(&options.robot, &options.recordings)?;
    if !options.sim.is_empty() {
        check::recordings(&options.robot, &options.sim).map_err(simulators)?;
    }
    let families = families::all();
    let how = &options.conditioning;
    let urdf = options.urdf.as_deref();
    let (train, test) = how.split.cut(&options.recordings, &how.start_s)?;
    let how = |set: &Set| Conditioning { start_s: set.start_s.clone(), folds: set.folds.clone(), ..how.clone() };
    let mut scene = Scene::new(&options.robot, urdf, &train.recordings, &how(&train))?;
    let simulator = match options.sim.is_empty() {
        true => None,
        false => {
            progress(0.0, "what the simulator contains");
            Some(Simulator::fit(options, &families, calibration, &mut |share, words| progress(0.4 * share, words))?)
        }
    };
    let difference = simulator.as_ref().and_then(|s| s.difference(&scene));
    let known = simulator.as_ref().map(|s| s.take_from(&mut scene, &families));
    let from = if simulator.is_some() { 0.4 } else { 0.0 };
    let progress = &mut |share: f64, words: &str| progress(from + (1.0 - from) * share, words);
    let found = find(&mut scene, (&families, calibration), known.as_ref(), progress)?;
    let test_scene = match test.recordings.is_empty() {
        true => None,
        false => {
            let how = Conditioning { band_hz: Some(scene.band_hz), ..how(&test) };
            let mut there = Scene::new(&options.robot, urdf, &test.recordings, &how)
                .map_err(|e| BadInput { what: format!("test: {}", e.what), ..e })?;
            if found.base.measured_load && !there.has_sensors() {
                return Err(BadInput::new(
                    "test: found recordings without the columns of columns.link_torque; expected them as in training",
                ));
            }
            there.count_above(&scene.slow_rad_s);
            let known = simulator.as_ref().map(|s| s.take_from(&mut there, &families));
            transfer::blank(&mut there, &families, &found.limits, found.fitted());
            let known = known.map(|raw| there.column(raw));
            Some((there, known))
        }
    };
    let known = known.map(|raw| scene.column(raw));
    let search = found.search(&scene, &families);
    let split = options.conditioning.split.name(options.recordings.len());
    let material = report::Material {
        scene: &scene,
        base: &found.base,
        search: &search,
        selection: &found.selection,
        calibration,
        seed: options.seed,
        known: known.as_ref(),
        test: test_scene.as_ref().map(|(scene, known)| report::Judged { scene, known: known.as_ref() }),
        simulator: simulator.as_ref(),
        split: &split,
    };
    let mut outcome = report::outcome(&material, progress).ok_or_else(unusable)?;
    outcome.evidence.train = train.stretches();
    outcome.evidence.test = test.stretches();
    if let Some(simulator) = &simulator {
        let unit = options.robot.torque_unit.symbol();
        outcome.evidence.simulator = simulator.words(difference.as_ref(), unit);
    }
    Ok(outcome)
}

/// The same error, said of the simulator's recordings.
pub(crate) fn simulators(e: BadInput) -> BadInput {
    BadInput { what: format!("simulator: {}", e.what), ..e }
}

fn unusable() -> BadInput {
    BadInput::new("recordings: the regression is singular; expected recordings with more motion")
}

/// What the search ended with.
pub(crate) struct Found {
    base: Base,
    limits: Limits,
    base_rms_nm: Option<Vec<f64>>,
    selection: Selection,
}

impl Found {
    /// The search again, as it ended.
    fn search<'a>(&self, scene: &'a Scene, families: &'a [Family]) -> Search<'a> {
        Search::new(scene, families, self.base.target.clone(), self.limits.clone())
            .with_base_rms(self.base_rms_nm.clone())
    }

    fn fitted(&self) -> Fitted<'_> {
        Fitted { base: &self.base, model: &self.selection.model, state: &self.selection.state }
    }
}

/// Searches for what is missing. `known` is what a simulator was taken to explain of the torque already.
pub(crate) fn find(
    scene: &mut Scene,
    (families, calibration): (&[Family], &Calibration),
    known: Option<&Raw>,
    progress: &mut dyn FnMut(f64, &str),
) -> Result<Found, BadInput> {
    let mut seeds: Vec<Seed> = Vec::new();
    let mut banned: Vec<usize> = Vec::new();
    let whole = scene.counting();
    // What is found may say that some stretches must not count; then the search is run again without them. What does
    // not hold there was found in error, and its stretches count again.
    let mut width: Option<Vec<f64>> = None;
    let mut renewed = 0;
    for last in [false, false, false, false, true] {
        progress(0.1, "fitting the base");
        let mut base = choose_base(scene);
        if let Some(width) = &width {
            base.set_widths(scene, width);
        }
        let noise_nm = report::noise_floor(scene);
        let mut torque = base.torque.clone();
        if let Some(known) = known {
            search::subtract(&mut torque, &scene.column(known.clone()), -1.0);
        }
        let floor_nm = floor(scene, &torque, &noise_nm);
        let limits = Limits {
            entry: families.iter().map(|f| calibration.entry_of(&f.key())).collect(),
            column: 6.0,
            floor_nm,
            noise_nm,
            most: 10,
            banned: banned.clone(),
            // Beside a term whose shape is still rough the first choice may be the wrong one.
            renew_widths: !last && renewed < MOST_WIDTHS,
            last,
        };
        let search = Search::new(scene, families, base.target.clone(), limits.clone());
        let selection = search.select(&base, &seeds, progress).ok_or_else(unusable)?;
        if !selection.fallen.is_empty() && !last {
            let names: Vec<&str> = selection.fallen.iter().map(|f| families[*f].id()).collect();
            progress(0.1, &format!("again without {}, which did not hold", names.join(" and ")));
            banned.extend(&selection.fallen);
            seeds.clear();
            drop(search);
            scene.count_again(&whole);
            continue;
        }
        if let Some(better) = selection.width.clone() {
            renewed += 1;
            progress(0.1, &format!("again with friction that turns round over {better:.5?} rad"));
            width = Some(better);
            continue;
        }
        if selection.blank.is_empty() || last {
            let base_rms_nm = search.base_rms_nm.get().cloned();
            let selection = sharpen::sharpened(&search, &base, selection, progress).ok_or_else(unusable)?;
            return Ok(Found { base, limits, base_rms_nm, selection });
        }
        seeds = selection
            .model
            .atoms
            .iter()
            .filter(|a| families[a.family].driven || !a.carries.is_empty())
            .map(|a| Seed {
                family: a.family,
                joint: a.joint,
                shape: a.shape.clone(),
                carries: a.carries.clone(),
                held: (a.fixed && !a.carries.is_empty()).then(|| a.amplitude.clone()),
            })
            .collect();
        let blank = selection.blank.clone();
        progress(0.1, &format!("again without {} stretches", blank.len()));
        drop(search);
        scene.blank(&blank);
    }
    Err(unusable())
}

/// How often the search begins anew with other travels of the friction states.
const MOST_WIDTHS: usize = 2;

/// Largest relative error at which a robot file's masses are taken for the base.
const NOMINAL_ERROR: f64 = 0.3;

/// What the sensors behind the gears measured as the base where there are any; the robot file's masses where they are given and fit; otherwise a freely fitted base.
fn choose_base(scene: &Scene) -> Base {
    if scene.has_sensors() {
        return Base::transmission(scene);
    }
    let delta = scene.body.as_delta().is_some();
    let nominal = (delta || scene.pi.iter().any(|v| *v != 0.0)).then(|| Base::nominal(scene));
    match nominal {
        Some(base) if delta || base.relative_error(scene) < NOMINAL_ERROR => base,
        _ => Base::free(scene),
    }
}

/// Smallest torque that counts as a finding, per joint [Nm]: a share of the noise in the band and of the
/// torque's size.
fn floor(scene: &Scene, torque: &Column, noise: &[f64]) -> Vec<f64> {
    (0..scene.joints)
        .map(|j| {
            let count = scene.mask[j].iter().filter(|m| **m).count().max(1) as f64;
            let size = (torque.part[j].iter().map(|v| v * v).sum::<f64>() / count).sqrt();
            (0.4 * noise[j]).max(0.0015 * size)
        })
        .collect()
}
