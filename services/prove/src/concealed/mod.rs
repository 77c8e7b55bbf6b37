//! Concealed, simulated: the simulator draws a robot, its motions, noise and zero to three effects; the recordings go
//! to one folder, the sealed answer elsewhere; the diagnosis sees the recordings and the robot file alone.

pub mod draw;

use crate::diagnosis::Answered;
use crate::error::Error;
use crate::hidden::Hidden;
use crate::score::{self, judge};
use crate::seal::Vault;
use crate::section::{Aim, Figure, Section, short};
use crate::{Options, Part, Watcher, Workplace};
use draw::{Class, Drawn, Plan};
use lacuna_simulate::Truth;
use lacuna_simulate::output::robot_toml;

const TITLE: &str = "Concealed, simulated";

/// Cases by default.
pub const CASES: usize = 220;

/// A proof of so many cases also measures the run time on recordings of the size that was asked about.
const TIMED_FROM: usize = 50;

/// Share of the bar that drawing takes.
const DRAWING: f64 = 0.15;

/// Draws, seals, diagnoses, opens, judges.
///
/// # Errors
/// [`Error`] if a case cannot be drawn or written, or an answer is not the sealed one.
pub fn prove(options: &Options, watcher: &mut dyn Watcher) -> Result<Section, Error> {
    let count = options.cases.unwrap_or(CASES);
    let plans = draw::plans(count, options.seed);
    let place = Workplace::new(options.out.as_deref(), "concealed")?;
    let mut vault = Vault::new()?;
    let mut redrawn = 0;
    for (k, plan) in plans.iter().enumerate() {
        watcher.at(DRAWING * k as f64 / count as f64, &format!("simulating case {} of {count}", k + 1));
        let drawn = draw::case(plan, options.seed, k as u64)?;
        redrawn += drawn.redrawn;
        write(&place, &mut vault, &name(k), &drawn)?;
    }
    for seal in vault.seals() {
        watcher.say(&format!("sealed  {}  {}", seal.hash, seal.name));
    }
    watcher.say(&format!("sealed  {}  all of the above", vault.digest()));
    let mut answers = Vec::new();
    for k in 0..count {
        let share = DRAWING + (1.0 - DRAWING) * k as f64 / count as f64;
        watcher.at(share, &format!("diagnosing case {} of {count}", k + 1));
        answers.push(diagnose(options, &place, &name(k))?);
    }
    // From here on the answers are read; no diagnosis runs any more.
    let mut judged = Vec::new();
    for (k, answered) in answers.iter().enumerate() {
        let text = vault.open(&name(k))?;
        place.write(&format!("answers/{}.json", name(k)), &text)?;
        let truth: Truth =
            serde_json::from_str(&text).map_err(|e| Error::Run(format!("{}: answer cannot be read: {e}", name(k))))?;
        let mut case = judge(&name(k), &Hidden::of_truth(&truth), answered);
        case.line = format!("{}; {}", plans[k].words(), case.line);
        judged.push(case);
    }
    let mut section = head(options, &plans, redrawn, &vault.digest());
    score::section(&mut section, &judged);
    if count >= TIMED_FROM {
        watcher.at(1.0, "timing a diagnosis of 6 recordings of 16 s");
        section.figures.push(timed(options, &place)?);
    }
    Ok(section)
}

/// A case's name, which tells nothing.
fn name(k: usize) -> String {
    format!("case_{:03}", k + 1)
}

fn write(place: &Workplace, vault: &mut Vault, name: &str, drawn: &Drawn) -> Result<(), Error> {
    let folder = place.folder(&format!("cases/{name}"))?;
    drawn.simulation.write(&folder).map_err(|e| Error::Run(e.to_string()))?;
    place.write(&format!("cases/{name}/robot.toml"), &robot_toml(&drawn.robot)?)?;
    vault.seal(name, &drawn.simulation.truth.to_json()?)?;
    Ok(())
}

fn diagnose(options: &Options, place: &Workplace, name: &str) -> Result<Answered, Error> {
    let folder = place.folder(&format!("cases/{name}"))?;
    let findings = place.folder(&format!("findings/{name}"))?;
    options.diagnosis.run(&folder, "robot.toml", &recordings(&folder)?, &findings)
}

/// The recordings in a folder, in order.
pub(crate) fn recordings(folder: &std::path::Path) -> Result<Vec<String>, Error> {
    let entries = std::fs::read_dir(folder).map_err(crate::error::io("read", folder))?;
    let names = entries.flatten().filter_map(|e| e.file_name().into_string().ok());
    let mut list: Vec<String> = names.filter(|n| n.ends_with(".csv")).collect();
    list.sort();
    Ok(list)
}

/// Run time on the size that was asked about: 6 recordings × 16 s × 3 joints.
fn timed(options: &Options, place: &Workplace) -> Result<Figure, Error> {
    let plan = Plan::timing();
    let drawn = draw::case(&plan, options.seed, draw::TIMING_CASE)?;
    let folder = place.folder("timing/recordings")?;
    drawn.simulation.write(&folder).map_err(|e| Error::Run(e.to_string()))?;
    place.write("timing/recordings/robot.toml", &robot_toml(&drawn.robot)?)?;
    let out = place.folder("timing/findings")?;
    let answered = options.diagnosis.run(&folder, "robot.toml", &recordings(&folder)?, &out)?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let text = format!("{} s on {cores} cores", short(answered.seconds, 3));
    Ok(Figure::new(
        "run time of a diagnosis, 6 recordings × 16 s × 3 joints at 1 kHz",
        answered.seconds,
        text,
        Aim::Most(10.0),
    ))
}

fn head(options: &Options, plans: &[Plan], redrawn: usize, digest: &str) -> Section {
    let of = |class: Class| plans.iter().filter(|p| p.class == class).count();
    let deltas = plans.iter().filter(|p| p.is_delta()).count();
    let off = plans.iter().filter(|p| p.mass_error > 0.0).count();
    let bare = plans.iter().filter(|p| p.bare).count();
    Section {
        part: Part::Concealed.name().to_owned(),
        title: TITLE.to_owned(),
        command: options.command(Part::Concealed),
        conditions: vec![
            format!(
                "{} cases: {} clean, {} with one effect of the catalogue, {} with two or three, {} with one outside the \
                 catalogue (half of them beside one of the catalogue).",
                plans.len(),
                of(Class::Clean),
                of(Class::Single),
                of(Class::Several),
                of(Class::Outside)
            ),
            format!(
                "{deltas} Delta robots and {} arms of 2 to 6 joints ({bare} of them with a robot file that has no masses); \
                 6 recordings of 5 s; strength of every effect drawn from {} to {} times usual.",
                plans.len() - deltas,
                draw::SEVERITY[0],
                draw::SEVERITY[1]
            ),
            format!("{off} robots differ from their file by up to the tolerance that the file states (1 to 3 %)."),
            format!(
                "Seeds from 2^40 on, block {}, used by nothing else; {redrawn} draws were rejected because the robot could \
                 not follow its motion.",
                options.seed
            ),
            format!("Answers sealed before the first diagnosis; SHA-256 over their hashes {digest}."),
            "A share of the residual is the RMS torque behind an effect over that of all effects and of what the true \
             model would leave."
                .to_owned(),
        ],
        ..Section::default()
    }
}
