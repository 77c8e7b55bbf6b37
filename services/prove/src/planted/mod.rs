//! Concealed in real recordings: an effect is added to the measured torque of a real robot, and must be named beyond
//! what was found before; and what is known of a real robot is withheld from its model, and must be found.

pub mod laws;
pub mod motion;
mod withheld;

use crate::error::Error;
use crate::said::{Finding, Said};
use crate::section::{Aim, Figure, Section, Table, short};
use crate::seeds;
use crate::{Options, Part, Watcher, Workplace};
use lacuna_estimation::filter::{Interpolation, resample};
use lacuna_estimation::stats::quantile;
use lacuna_interfaces::Recording;
use lacuna_recording::{LoadedRobot, load_robot, read_all};
use lacuna_simulate::random::Random;
use lacuna_simulate::write_csv;
use laws::{PLANTS, Plant, Site, unit};
use motion::Motion;
use std::path::{Path, PathBuf};

const TITLE: &str = "Concealed in real recordings";

/// A robot whose recordings take plants.
struct Host {
    folder: &'static str,
    /// Recordings that are used.
    files: &'static [&'static str],
    /// The first axis is vertical: gravity says nothing there, a spring is seen.
    vertical: bool,
}

const HOSTS: [Host; 3] = [
    Host {
        folder: "dfki_double_pendulum",
        files: &["design_A.0_20220812_20220812-061157-PM_measured.csv"],
        vertical: false,
    },
    Host { folder: "staubli_tx40", files: &["tx40_traj.csv"], vertical: true },
    Host { folder: "kuka_kr300", files: &["traj_A.csv", "traj_B.csv", "traj_C.csv"], vertical: true },
];

/// Share of the residual after planting that the plant is.
const SHARES: [f64; 2] = [0.5, 0.2];

/// Bands of what is visible of a plant: from, to, words, aim.
const VISIBLE: [(f64, f64, &str, Aim); 3] = [
    (0.3, f64::INFINITY, "visible part at least 30 % of the residual", Aim::Least(0.95)),
    (0.1, 0.3, "visible part 10 to 30 %", Aim::Least(0.8)),
    (0.0, 0.1, "visible part below 10 %", Aim::None),
];

/// Speed above which a joint counts as moving [rad/s].
const MOVING: f64 = 0.05;

/// A host with its recordings and what is found in them as they are.
struct Ground {
    host: &'static Host,
    robot: LoadedRobot,
    recordings: Vec<Recording>,
    motions: Vec<Motion>,
    before: Said,
}

/// One plant and what became of it.
struct Planted {
    plant: Plant,
    robot: &'static str,
    joint: String,
    share: f64,
    /// Share of the residual that is left of it once the base is fitted again, on the joint where it is largest.
    visible: f64,
    named: bool,
    /// New names beyond the planted one.
    other: Vec<String>,
    line: String,
}

/// Plants, withholds, diagnoses, judges.
///
/// # Errors
/// [`Error`] if recordings cannot be read or written.
pub fn prove(options: &Options, watcher: &mut dyn Watcher) -> Result<Section, Error> {
    let data = options.shared.join("data");
    if !data.is_dir() {
        return Ok(Section::skipped(Part::Planted, TITLE, options, format!("no recordings at {}", data.display())));
    }
    let place = Workplace::new(options.out.as_deref(), "planted")?;
    let list = plan(options.cases.unwrap_or(usize::MAX));
    let mut section = head(options, list.len());
    let mut grounds: Vec<Option<Ground>> = Vec::new();
    for (k, host) in HOSTS.iter().enumerate() {
        watcher.at(0.1 * k as f64 / HOSTS.len() as f64, &format!("{} as it is", host.folder));
        match ground(options, &place, &data, host)? {
            Ok(g) => grounds.push(Some(g)),
            Err(why) => {
                section.failures.push(format!("{}: not used: {why}", host.folder));
                grounds.push(None);
            }
        }
    }
    let mut random = Random::new(seeds::seed(options.seed, 0, 0), 78);
    let mut done = Vec::new();
    for (k, (plant, share, host)) in list.iter().enumerate() {
        let words = format!("{plant:?} into {} ({} of {})", HOSTS[*host].folder, k + 1, list.len());
        watcher.at(0.1 + 0.8 * k as f64 / list.len() as f64, &words);
        let Some(ground) = &grounds[*host] else { continue };
        match plant_one(options, &place, ground, k, (*plant, *share), &mut random)? {
            Ok(p) => done.push(p),
            Err(why) => section.failures.push(format!("{plant:?} into {}: not planted: {why}", HOSTS[*host].folder)),
        }
    }
    watcher.at(0.92, "withholding what is known");
    judge(&mut section, &done);
    withheld::judge(options, &place, &data, &mut section)?;
    Ok(section)
}

/// Every plant at both strengths on two of the three robots.
fn plan(most: usize) -> Vec<(Plant, f64, usize)> {
    let mut list = Vec::new();
    for (s, share) in SHARES.iter().enumerate() {
        for (p, plant) in PLANTS.iter().enumerate() {
            let fits = |h: &usize| *plant != Plant::GravitySpring || HOSTS[*h].vertical;
            let turns = (0..HOSTS.len()).map(|r| (p + s + r) % HOSTS.len());
            list.extend(turns.filter(fits).take(2).map(|h| (*plant, *share, h)));
        }
    }
    list.truncate(most);
    list
}

fn ground(
    options: &Options,
    place: &Workplace,
    data: &Path,
    host: &'static Host,
) -> Result<Result<Ground, String>, Error> {
    let folder = data.join(host.folder);
    if !folder.is_dir() {
        return Ok(Err(format!("no recordings at {}", folder.display())));
    }
    let robot = load_robot(folder.join("robot.toml"))?;
    let read = |f: &&str| read_all(folder.join(f), &robot.file);
    let recordings: Vec<Recording> = host.files.iter().map(read).collect::<Result<_, _>>()?;
    let motions = recordings.iter().map(Motion::of).collect::<Result<_, _>>()?;
    let answered = diagnose(options, place, &format!("{}_as_it_is", host.folder), &robot, &recordings)?;
    Ok(answered.map(|before| Ground { host, robot, recordings, motions, before }))
}

/// Writes recordings and robot file to `cases/NAME` and diagnoses them there.
fn diagnose(
    options: &Options,
    place: &Workplace,
    name: &str,
    robot: &LoadedRobot,
    recordings: &[Recording],
) -> Result<Result<Said, String>, Error> {
    let folder = place.folder(&format!("cases/{name}"))?;
    place.write(&format!("cases/{name}/robot.toml"), &robot.toml)?;
    if let (Some(text), Some(file)) = (&robot.urdf, &robot.file.urdf) {
        place.write(&format!("cases/{name}/{file}"), text)?;
    }
    let mut files = Vec::new();
    for recording in recordings {
        let path: PathBuf = folder.join(&recording.name);
        let file = std::fs::File::create(&path).map_err(crate::error::io("written", &path))?;
        let mut out = std::io::BufWriter::new(file);
        write_csv(recording, &mut out).map_err(crate::error::io("written", &path))?;
        std::io::Write::flush(&mut out).map_err(crate::error::io("written", &path))?;
        files.push(recording.name.clone());
    }
    let out = place.folder(&format!("findings/{name}"))?;
    Ok(options.diagnosis.run(&folder, "robot.toml", &files, &out)?.said)
}

/// Where a finding with one of `names` acts.
fn acts(said: &Said, names: &[&str], joint: Option<&str>) -> bool {
    let on = |f: &Finding| joint.is_none_or(|j| f.joints.is_empty() || f.joints.iter().any(|k| k == j));
    let named = |f: &Finding| {
        names.contains(&f.effect.as_str()) || names.first().is_some_and(|n| f.group.iter().any(|g| g == n))
    };
    said.findings.iter().any(|f| named(f) && on(f))
}

fn plant_one(
    options: &Options,
    place: &Workplace,
    ground: &Ground,
    number: usize,
    (plant, share): (Plant, f64),
    random: &mut Random,
) -> Result<Result<Planted, String>, Error> {
    let robot = &ground.robot.file;
    let Some(joint) = choose_joint(ground, plant, random) else {
        return Ok(Err("it was found on every joint before".to_owned()));
    };
    let turns: Vec<f64> = ground.motions.iter().flat_map(|m| &m.qd[joint]).map(|v| v.abs()).collect();
    let gear = robot.drive.gear_ratio.as_ref().and_then(|g| g.get(joint)).unwrap_or(1.0).abs();
    let urdf = ground.robot.urdf.as_deref();
    let site = Site { robot, urdf, joint, order: 2.0 * gear, v_s: quantile(&turns, 0.3).max(2.0 * MOVING) };
    let units = ground.motions.iter().map(|m| unit(plant, &site, m)).collect::<Result<Vec<_>, _>>()?;
    let Some(amplitude) = amplitude(ground, plant, joint, share, &units) else {
        return Ok(Err("the joint does not move enough".to_owned()));
    };
    let mut recordings = ground.recordings.clone();
    for (recording, unit) in recordings.iter_mut().zip(&units) {
        add(plant, recording, unit, amplitude)?;
    }
    let name = format!("{:02}_{}", number + 1, ground.host.folder);
    let said = diagnose(options, place, &name, &ground.robot, &recordings)?;
    let joint = robot.joints.get(joint).cloned().unwrap_or_default();
    Ok(Ok(judged(ground, plant, share, joint, amplitude, said)))
}

fn judged(
    ground: &Ground,
    plant: Plant,
    share: f64,
    joint: String,
    amplitude: f64,
    said: Result<Said, String>,
) -> Planted {
    let on = (!plant.whole()).then_some(joint.as_str());
    let named = said.as_ref().is_ok_and(|s| acts(s, plant.names(), on));
    let new = |f: &&Finding| {
        !plant.names().contains(&f.effect.as_str()) && !ground.before.findings.iter().any(|b| b.effect == f.effect)
    };
    let other = said.iter().flat_map(|s| &s.findings).filter(new).map(Finding::words).collect();
    let words = |s: &Said| match s.findings.is_empty() {
        true => "nothing".to_owned(),
        false => s.findings.iter().map(Finding::words).collect::<Vec<_>>().join(", "),
    };
    let place = if plant.whole() { "whole robot".to_owned() } else { joint.clone() };
    let visible = said.as_ref().map_or(0.0, |s| visible(&ground.before, s));
    let line = format!(
        "{} {plant:?} on {place}, {:.0} % of the residual, {:.0} % of it visible (amplitude {}): before {}; after {}",
        ground.host.folder,
        100.0 * share,
        100.0 * visible,
        short(amplitude, 3),
        words(&ground.before),
        match &said {
            Ok(s) => words(s),
            Err(why) => format!("no findings: {why}"),
        }
    );
    Planted { plant, robot: ground.host.folder, joint: place, share, visible, named, other, line }
}

/// Share of the base's residual that a plant makes, √(1 − before²/after²), on the joint where it is largest: what a base
/// that is fitted again takes over is gone for everybody.
fn visible(before: &Said, after: &Said) -> f64 {
    let pairs = before.baseline.rms_nm.iter().zip(&after.baseline.rms_nm);
    pairs.map(|(b, a)| (1.0 - (b / a.max(1e-12)).powi(2)).max(0.0).sqrt()).fold(0.0, f64::max)
}

/// A joint on which the effect was not found before.
fn choose_joint(ground: &Ground, plant: Plant, random: &mut Random) -> Option<usize> {
    let names = &ground.robot.file.joints;
    if plant == Plant::GravitySpring {
        return (!acts(&ground.before, plant.names(), names.first().map(String::as_str))).then_some(0);
    }
    let free: Vec<usize> = (0..names.len())
        .filter(|j| !acts(&ground.before, plant.names(), (!plant.whole()).then_some(names[*j].as_str())))
        .collect();
    free.get(random.index(free.len())).copied()
}

/// Amplitude with which the plant is `share` of the residual after planting, on the joint where it is largest beside
/// what was there; `None` if the joint does not move.
fn amplitude(ground: &Ground, plant: Plant, joint: usize, share: f64, units: &[Vec<Vec<f64>>]) -> Option<f64> {
    let ratio = |j: usize| {
        let (mut sum, mut count) = (0.0, 0.0);
        for (motion, unit) in ground.motions.iter().zip(units) {
            for (v, u) in motion.qd[j].iter().zip(&unit[j]).filter(|(v, _)| v.abs() > MOVING) {
                let _ = v;
                sum += u * u;
                count += 1.0;
            }
        }
        let rms = f64::sqrt(sum / f64::max(count, 1.0));
        rms / ground.before.baseline.rms_nm.get(j).copied().unwrap_or(f64::INFINITY).max(1e-12)
    };
    let joints: Vec<usize> = if plant.whole() { (0..units.first()?.len()).collect() } else { vec![joint] };
    let largest = joints.into_iter().map(ratio).fold(0.0, f64::max);
    (largest > 0.0).then(|| share / (1.0 - share * share).sqrt() / largest)
}

fn add(plant: Plant, recording: &mut Recording, unit: &[Vec<f64>], amplitude: f64) -> Result<(), Error> {
    if plant == Plant::Delay {
        // The whole signal comes late, noise and all.
        let late: Vec<f64> = recording.t_s.iter().map(|t| t - 1e-3 * amplitude).collect();
        for tau in &mut recording.tau_nm {
            *tau = resample(&recording.t_s, tau, &late, Interpolation::Linear)?;
        }
        return Ok(());
    }
    for (tau, unit) in recording.tau_nm.iter_mut().zip(unit) {
        tau.iter_mut().zip(unit).for_each(|(t, u)| *t += amplitude * u);
    }
    Ok(())
}

fn judge(section: &mut Section, done: &[Planted]) {
    for (low, high, words, aim) in VISIBLE {
        let band = || done.iter().filter(|p| (low..high).contains(&p.visible));
        let hits = band().filter(|p| p.named).count();
        section.figures.push(Figure::share(&format!("{words}: named on its joint"), hits, band().count(), aim));
    }
    let with_other = done.iter().filter(|p| !p.other.is_empty()).count();
    section.figures.push(Figure::share("plants that brought another new name", with_other, done.len(), Aim::None));
    let mut table = Table::new("Plants", &["plant", "robot", "joint", "share", "visible", "named", "other new names"]);
    for p in done {
        let other = if p.other.is_empty() { "-".to_owned() } else { p.other.join(", ") };
        let named = if p.named { "yes" } else { "MISSED" };
        table.rows.push(vec![
            p.plant.names()[0].to_owned(),
            p.robot.to_owned(),
            p.joint.clone(),
            format!("{:.0} %", 100.0 * p.share),
            format!("{:.0} %", 100.0 * p.visible),
            named.to_owned(),
            other,
        ]);
    }
    section.tables.push(table);
    section.failures.extend(done.iter().filter(|p| !p.named || !p.other.is_empty()).map(|p| p.line.clone()));
}

fn head(options: &Options, plants: usize) -> Section {
    Section {
        part: Part::Planted.name().to_owned(),
        title: TITLE.to_owned(),
        command: options.command(Part::Planted),
        conditions: vec![
            format!(
                "{plants} plants into recordings of a double pendulum (T-Motor), a Stäubli TX40 and a KUKA KR300: torque \
                 columns plus the law along the low-passed (20 Hz) motion, everything else as recorded."
            ),
            "Strength by its share of the residual's RMS after planting; visible is what is left of it once the base \
             (masses where the file gives none, friction, offsets) is fitted again, √(1 − before²/after²) of the base's \
             error held out. A plant counts as named if it is found on its joint, where it was not found before."
                .to_owned(),
            "The files of the pendulum and of the KUKA give no masses: what a freely fitted rigid body takes over (parts of \
             a gain error, of a spring, of an offset) cannot be seen there."
                .to_owned(),
        ],
        ..Section::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_plant_is_planted_at_both_strengths() {
        let all = plan(usize::MAX);
        for plant in PLANTS {
            for share in SHARES {
                assert!(all.iter().any(|p| p.0 == plant && p.1 == share), "{plant:?} {share}");
            }
        }
        assert!(all.iter().all(|p| p.0 != Plant::GravitySpring || HOSTS[p.2].vertical));
        assert_eq!(plan(5).len(), 5);
    }
}
