//! What is known of a real robot is not in its model: wrist coupling, friction, gravity. Is it found, with the numbers
//! that others published?

use super::diagnose;
use crate::error::Error;
use crate::said::{Finding, Said};
use crate::section::{Section, Table, short};
use crate::{Options, Workplace};
use lacuna_interfaces::ModelFile;
use lacuna_recording::files::read_text;
use lacuna_recording::{LoadedRobot, load_robot, read_all};
use lacuna_simulate::output::robot_toml;
use std::collections::BTreeMap;
use std::path::Path;

/// Adds the table of what was withheld.
pub fn judge(options: &Options, place: &Workplace, data: &Path, section: &mut Section) -> Result<(), Error> {
    let mut table = Table::new("Withheld from the model", &["withheld", "expected", "found", "verdict"]);
    let tx40 = data.join("staubli_tx40");
    if tx40.is_dir() {
        let robot = load_robot(tx40.join("robot.toml"))?;
        let recording = read_all(tx40.join("tx40_traj.csv"), &robot.file)?;
        let name = "withheld_wrist_and_friction";
        let said = diagnose(options, place, name, &robot, &[recording])?;
        let published = Published::read(&tx40.join("TX40_bp_5.csv"))?;
        let model = read_model(place, name);
        coupling(&mut table, said.as_ref(), &published);
        friction(&mut table, model.as_ref(), &published);
    }
    let pendulum = data.join("dfki_double_pendulum");
    if pendulum.is_dir() {
        gravity(options, place, &pendulum, &mut table)?;
    }
    let missed = table.rows.iter().filter(|r| r.last().is_some_and(|v| v != "found"));
    section.failures.extend(missed.map(|r| format!("withheld {}: expected {}; found {}", r[0], r[1], r[2])));
    section.tables.push(table);
    Ok(())
}

fn verdict(ok: bool) -> String {
    if ok { "found" } else { "MISSED" }.to_owned()
}

/// A model file that a diagnosis wrote, if it did.
fn read_model(place: &Workplace, name: &str) -> Option<ModelFile> {
    let folder = place.folder(&format!("findings/{name}")).ok()?;
    ModelFile::parse(&read_text(&folder.join("model.toml")).ok()?).ok()
}

/// Base parameters published with the recording: name, value, standard deviation in per cent.
struct Published(BTreeMap<String, (f64, f64)>);

impl Published {
    fn read(path: &Path) -> Result<Self, Error> {
        let row = |line: &str| {
            let mut cells = line.split(',');
            let name = cells.next()?.trim().to_owned();
            Some((name, (cells.next()?.trim().parse().ok()?, cells.next()?.trim().parse().ok()?)))
        };
        Ok(Self(read_text(path)?.lines().filter_map(row).collect()))
    }

    /// Value and two standard deviations.
    fn get(&self, name: &str) -> Option<(f64, f64)> {
        self.0.get(name).map(|(v, percent)| (*v, (2.0 * v * percent / 100.0).abs()))
    }
}

fn coupling(table: &mut Table, said: Result<&Said, &String>, published: &Published) {
    let finding = said.ok().and_then(|s| s.named("axis_coupling").find(|f| f.joints == ["joint_5", "joint_6"]));
    let found = finding.map_or("not named".to_owned(), Finding::words);
    let row = |what: &str, expected: &str, found: String, ok: bool| {
        vec![what.to_owned(), expected.to_owned(), found, verdict(ok)]
    };
    table.rows.push(row(
        "TX40: coupling of axes 5 and 6",
        "axis_coupling (joint_5, joint_6)",
        found,
        finding.is_some(),
    ));
    for (symbol, name) in [("J", "Iam6"), ("f_v", "fvm6"), ("f_c", "fsm6")] {
        let Some((value, two)) = published.get(name) else { continue };
        let fitted = finding.and_then(|f| f.parameters.iter().find(|p| p.symbol == symbol)).and_then(|p| p.value);
        // The published fit has no band and no hold-out of ours: a tenth is granted beside its own interval.
        let ok = fitted.is_some_and(|v| (v.abs() - value).abs() <= two.max(0.1 * value.abs()));
        let expected = format!("{name} = {} ± {} (two published σ)", short(value, 3), short(two, 2));
        table.rows.push(row(
            &format!("TX40: its {symbol}"),
            &expected,
            fitted.map_or("-".to_owned(), |v| short(v, 3)),
            ok,
        ));
    }
}

fn friction(table: &mut Table, model: Option<&ModelFile>, published: &Published) {
    for j in 1..=6 {
        let lists = [("fv", "f_v", model.map(|m| &m.friction.f_v)), ("fs", "f_c", model.map(|m| &m.friction.f_c))];
        for (name, symbol, list) in lists {
            let Some((value, two)) = published.get(&format!("{name}{j}")) else { continue };
            let fitted = list.and_then(|l| l.get(j - 1)).copied();
            let ok = fitted.is_some_and(|v| (v - value).abs() <= two.max(0.1 * value.abs()));
            table.rows.push(vec![
                format!("TX40: {symbol} of joint {j}"),
                format!("{name}{j} = {} ± {}", short(value, 3), short(two, 2)),
                fitted.map_or("-".to_owned(), |v| short(v, 3)),
                verdict(ok),
            ]);
        }
    }
}

/// The double pendulum's file says that there is no gravity.
fn gravity(options: &Options, place: &Workplace, folder: &Path, table: &mut Table) -> Result<(), Error> {
    let loaded = load_robot(folder.join("robot.toml"))?;
    let recording = read_all(folder.join(super::HOSTS[0].files[0]), &loaded.file)?;
    let mut file = loaded.file.clone();
    file.env.gravity = [0.0; 3];
    let robot = LoadedRobot { toml: robot_toml(&file)?, file, ..loaded };
    let said = diagnose(options, place, "withheld_gravity", &robot, &[recording])?;
    for joint in ["shoulder", "elbow"] {
        let right = |f: &&Finding| {
            ["gravity_spring", "arm_inertia", "base_tilt"].contains(&f.effect.as_str())
                && (f.joints.is_empty() || f.joints.iter().any(|j| j == joint))
        };
        let finding = said.as_ref().ok().and_then(|s| s.findings.iter().find(right));
        let found = match (&said, finding) {
            (_, Some(f)) => f.words(),
            (Ok(s), None) => s.findings.iter().map(Finding::words).collect::<Vec<_>>().join(", "),
            (Err(why), None) => why.clone(),
        };
        table.rows.push(vec![
            format!("double pendulum: gravity at the {joint}"),
            "gravity_spring, arm_inertia or base_tilt".to_owned(),
            found,
            verdict(finding.is_some()),
        ]);
    }
    Ok(())
}
