//! The paper's own story, discovered: given the nominal model M_KH and recordings of a robot with more inertia than it
//! says, friction and a payload, the diagnosis must find inertia, friction and payload, in that order; and the paper's
//! tables follow step by step.

mod steps;

use crate::error::{Error, io};
use crate::said::{Finding, Said};
use crate::section::{Aim, Figure, Section, Table, short};
use crate::seeds;
use crate::{Options, Part, Watcher, Workplace};
use lacuna_interfaces::{ModelFile, Recording};
use lacuna_recording::files::read_text;
use lacuna_simulate::demo::{DEMO_PAYLOAD_KG, DEMO_ROBOT};
use lacuna_simulate::{Demo, Truth, demo_delta, write_csv};
use std::collections::BTreeMap;
use std::path::Path;
use steps::{Steps, spread};

const TITLE: &str = "The paper's own story, discovered";

/// Case number of the demo's robot in the proof's seeds.
const CASE: u64 = (1 << 15) - 2;

/// Free motions that the diagnosis is given: the paper's twelve, half of each kind.
const FREE: usize = 12;

/// Simulates, diagnoses with M_KH alone, and evaluates step by step.
///
/// # Errors
/// [`Error`] if the recordings cannot be made or read.
pub fn prove(options: &Options, watcher: &mut dyn Watcher) -> Result<Section, Error> {
    watcher.at(0.0, "simulating the paper's robot");
    let demo = demo_delta(seeds::seed(options.seed, CASE, 0))?;
    let place = Workplace::new(options.out.as_deref(), "paper")?;
    let folder = place.folder("recordings")?;
    place.write("recordings/robot.toml", DEMO_ROBOT)?;
    let mut files = Vec::new();
    for (k, recording) in demo.training_motions().iter().take(FREE).enumerate() {
        files.push(write(&folder, &format!("free_{:02}.csv", k + 1), recording)?);
    }
    for recording in &demo.pick_place.recordings {
        files.push(write(&folder, CARRIED, recording)?);
    }
    if let Some(test) = demo.test_motion() {
        write(&place.folder("held_back")?, "v_f.csv", test)?;
    }
    watcher.at(0.2, "diagnosing with M_KH alone");
    let out = place.folder("findings")?;
    let answered = options.diagnosis.run(&folder, "robot.toml", &files, &out)?;
    let mut section = head(options);
    match &answered.said {
        Ok(said) => {
            let path = out.join("model.toml");
            let model = ModelFile::parse(&read_text(&path)?).map_err(|e| e.in_file(&path))?;
            watcher.at(0.9, "evaluating step by step");
            judge(&mut section, &demo, said, &model)?;
        }
        Err(why) => section.failures.push(format!("no findings: {why}")),
    }
    section.figures.push(Figure::new(
        "run time",
        answered.seconds,
        format!("{} s", short(answered.seconds, 3)),
        Aim::None,
    ));
    Ok(section)
}

/// Name of the pick-and-place.
const CARRIED: &str = "v_p.csv";

fn write(folder: &Path, name: &str, recording: &Recording) -> Result<String, Error> {
    let path = folder.join(name);
    let file = std::fs::File::create(&path).map_err(io("written", &path))?;
    let mut out = std::io::BufWriter::new(file);
    write_csv(recording, &mut out).map_err(io("written", &path))?;
    std::io::Write::flush(&mut out).map_err(io("written", &path))?;
    Ok(name.to_owned())
}

fn head(options: &Options) -> Section {
    Section {
        part: Part::Paper.name().to_owned(),
        title: TITLE.to_owned(),
        command: options.command(Part::Paper),
        conditions: vec![
            "A D3-1200-class Delta whose rotors carry 0.28 to 0.32 kg m² more than its file says (0.06), with forearms of \
             distributed mass, masses off by up to 3 %, friction, and 3.8 kg picked and placed."
                .to_owned(),
            "Given: the robot file (M_KH: masses, no friction), twelve free motions of 8 s and one pick-and-place of 10 s. \
             v_F, a thirteenth free motion, is not given."
                .to_owned(),
            "σ: standard deviation of the torque error over moving samples (0.05 rad/s), 20 Hz, as the paper's tables.".to_owned(),
        ],
        ..Section::default()
    }
}

/// Ids that carry more inertia or mass.
pub(crate) const INERTIA: [&str; 4] = ["rotor_inertia", "arm_inertia", "forearm_rod", "link_length"];

fn judge(section: &mut Section, demo: &Demo, said: &Said, model: &ModelFile) -> Result<(), Error> {
    let truth = &demo.free.truth;
    let yes = |measure: &str, ok: bool, text: String| {
        Figure::new(
            measure,
            f64::from(u8::from(ok)),
            format!("{}: {text}", if ok { "yes" } else { "no" }),
            Aim::Least(1.0),
        )
    };
    let all = || said.findings.iter().map(Finding::words).collect::<Vec<_>>().join(", ");
    let place = |ids: &[&str]| said.findings.iter().position(|f| ids.contains(&f.effect.as_str()));
    let rotors = ["rotor_inertia", "arm_inertia"];
    section.figures.push(yes("inertia of all joints is named first", named_first(said, &rotors), all()));
    section.figures.push(inertia(said, truth));
    section.figures.push(friction(model, truth));
    let payload = place(&["payload"]);
    section.figures.push(yes("the payload is named", payload.is_some(), all()));
    section.figures.push(mass(said));
    let steps = Steps::new(demo, said, model)?;
    let order = steps.order();
    let right = order == ["inertia", "friction", "payload"] && place(&rotors) < payload && payload.is_some();
    section.figures.push(yes("inertia, friction, payload in that order of size", right, order.join(", ")));
    tables(section, &steps);
    let known = |f: &&Finding| INERTIA.contains(&f.effect.as_str()) || f.effect == "payload";
    section.failures.extend(said.findings.iter().filter(|f| !known(f)).map(|f| format!("also found: {}", f.words())));
    let missed: Vec<String> = section
        .figures
        .iter()
        .filter(|f| f.reached == Some(false) || (f.value.is_none() && !f.aim.is_empty()))
        .map(|f| format!("{}: {}", f.measure, f.text))
        .collect();
    section.failures.extend(missed);
    section.conditions.push(format!("Its verdict: {}", said.verdict));
    Ok(())
}

fn named_first(said: &Said, ids: &[&str]) -> bool {
    said.findings.first().is_some_and(|f| ids.contains(&f.effect.as_str()) && f.joints.len() == said.joints.len())
}

/// Inertia found beyond the file, against what was added: by J or by I, whichever the finding gives.
fn inertia(said: &Said, truth: &Truth) -> Figure {
    let added: BTreeMap<&str, f64> = truth
        .effects
        .iter()
        .filter(|e| e.id == "rotor_inertia")
        .filter_map(|e| Some((e.joints.first()?.as_str(), *e.params.get("J")?)))
        .collect();
    let found = |joint: &str| {
        let of = |f: &Finding| {
            let p = f.parameter("J", Some(joint)).or(f.parameter("I", Some(joint)))?;
            f.joints.iter().any(|j| j == joint).then_some(p.value?)
        };
        said.findings.iter().filter(|f| ["rotor_inertia", "arm_inertia"].contains(&f.effect.as_str())).find_map(of)
    };
    let errors: Option<Vec<f64>> = added.iter().map(|(j, v)| Some(100.0 * (found(j)? - v).abs() / v)).collect();
    let worst = errors.map_or(f64::NAN, |e| e.into_iter().fold(0.0, f64::max));
    Figure::new(
        "inertia found: largest error over the rotors' surplus",
        worst,
        format!("{} %", short(worst, 2)),
        Aim::Most(10.0),
    )
}

fn friction(model: &ModelFile, truth: &Truth) -> Figure {
    let base = &truth.base_params;
    let pairs = model.friction.f_c.iter().zip(&base.fc).chain(model.friction.f_v.iter().zip(&base.fv));
    let errors: Vec<f64> = pairs.map(|(f, t)| 100.0 * (f - t).abs() / t).collect();
    let complete = errors.len() == base.fc.len() + base.fv.len();
    let worst = if complete { errors.into_iter().fold(0.0, f64::max) } else { f64::NAN };
    let text = format!("{} % (f_c and f_v of three joints)", short(worst, 2));
    Figure::new("friction found: largest error of its coefficients", worst, text, Aim::Most(10.0))
}

fn mass(said: &Said) -> Figure {
    let m = said.named("payload").find_map(|f| f.parameters.iter().find(|p| p.symbol == "m")).and_then(|p| p.value);
    let error = m.map_or(f64::NAN, |m| 100.0 * (m / DEMO_PAYLOAD_KG - 1.0).abs());
    let text = format!("{} % ({} kg of {DEMO_PAYLOAD_KG})", short(error, 2), short(m.unwrap_or(f64::NAN), 4));
    Figure::new("payload found: error of its mass", error, text, Aim::Most(3.0))
}

fn tables(section: &mut Section, steps: &Steps) {
    let rows = |columns: &[&Vec<Vec<f64>>]| -> Vec<Vec<String>> {
        let sigma = |c: &Vec<Vec<f64>>, j: usize| c.get(j).map_or("-".to_owned(), |e| short(spread(e), 3));
        let row = |j: usize| columns.iter().map(|c| sigma(c, j)).collect::<Vec<_>>();
        (0..3).map(|j| [vec![format!("τ{}", j + 1)], row(j)].concat()).collect()
    };
    let mut first = Table::new(
        "Table 1, σ of the torque error over v_F, a free motion it was not given [Nm]",
        &["joint", "M_KH", "+ inertia found", "+ friction found"],
    );
    first.rows.extend(rows(&[&steps.free.nominal, &steps.free.inertia, &steps.free.friction]));
    let mut second = Table::new(
        "Table 2, σ of the torque error over v_P, pick-and-place with 3.8 kg [Nm]",
        &["joint", "M_KH", "+ inertia found", "+ friction found", "+ payload found"],
    );
    let p = &steps.carried;
    second.rows.extend(rows(&[&p.nominal, &p.inertia, &p.friction, &p.payload]));
    section.tables.push(first);
    section.tables.push(second);
}
