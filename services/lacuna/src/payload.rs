//! `lacuna payload`: what a recording shows was carried, under an identified model.

use crate::progress::Progress;
use crate::{CommandResult, payload_report, words};
use clap::Args;
use lacuna_identify::payload::{self, Interval, Known, Options, PayloadRun};
use lacuna_interfaces::{BadInput, ModelFile, StageContext};
use lacuna_report::number::{percent, significant};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

/// Schema of the result.
const SCHEMA: &str = "lacuna.payload/1";

#[derive(Args)]
pub struct PayloadArgs {
    /// Robot file.
    #[arg(long, value_name = "FILE")]
    robot: PathBuf,
    /// Model file of `lacuna identify`, from recordings without payload.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// Recordings (CSV, MCAP or ROS 2 bag).
    #[arg(value_name = "RECORDING", required = true)]
    recordings: Vec<PathBuf>,
    /// Folder for payload.json and report.html.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    carried: CarriedArgs,
    /// Print payload.json on standard output, in place of the summary.
    #[arg(long)]
    json: bool,
}

/// Options of the estimate that `identify` shares.
#[derive(Args, serde::Serialize)]
pub struct CarriedArgs {
    /// When something is known to be carried, in seconds of the one recording's own time, e.g. from the gripper's log, and
    /// its mass if known. Without it, picks and places are found.
    #[arg(long, num_args = 1.., value_name = "FROM:TO[:KG]")]
    carried: Vec<String>,
    /// How much future a smoothed sample may use [s], as in the graph.
    #[arg(long, value_name = "SECONDS", default_value_t = Options::default().lag_s, allow_negative_numbers = true)]
    lag: f64,
}

impl CarriedArgs {
    /// The options.
    pub fn options(&self) -> Result<Options, BadInput> {
        let known: Vec<Known> = self.carried.iter().map(|text| text.parse()).collect::<Result<_, BadInput>>()?;
        Ok(Options { known, lag_s: words::not_negative("--lag", self.lag)?, ..Options::default() })
    }

    /// Whether times are given.
    pub fn any(&self) -> bool {
        !self.carried.is_empty()
    }
}

/// `payload.json`.
#[derive(Serialize)]
struct Account<'a> {
    schema: &'static str,
    robot: &'a str,
    joints: &'a [String],
    torque_unit: &'a str,
    model: &'a str,
    recordings: &'a [PayloadRun],
    warnings: &'a [String],
}

/// `lacuna payload`.
pub fn payload(args: &PayloadArgs) -> CommandResult {
    let options = args.carried.options()?;
    payload::check_known(args.recordings.len(), &options)?;
    if let Some(out) = &args.out {
        words::folder_for(out)?;
    }
    let loaded = lacuna_recording::load_robot(&args.robot)?;
    let (model, _): (ModelFile, String) = lacuna_recording::load_model(&args.model, &loaded.file)?;
    let context = StageContext { robot: &loaded.file, urdf: loaded.urdf.as_deref(), model: Some(&model) };
    let progress = Progress::spinner();
    let mut runs = Vec::new();
    for path in &args.recordings {
        progress.step(&format!("estimating the payload of {}", path.display()));
        runs.push(payload::payload(path, &context, &options)?);
    }
    let warnings: Vec<String> = runs.iter().flat_map(payload::warnings).collect();
    let account = Account {
        schema: SCHEMA,
        robot: &loaded.file.name,
        joints: &loaded.file.joints,
        torque_unit: loaded.file.torque_unit.symbol(),
        model: &model.origin,
        recordings: &runs,
        warnings: &warnings,
    };
    let mut files = String::new();
    if let Some(out) = &args.out {
        let data = payload_report::data(&loaded.file, &model.origin, &runs, &warnings);
        let json = serde_json::to_string_pretty(&account).map_err(|e| lacuna_stage::Failure::run(e.to_string()))?;
        words::write(&out.join("payload.json"), (json + "\n").as_bytes())?;
        words::write(&out.join("report.html"), lacuna_report::payload_report(&data).as_bytes())?;
        files = words::files(out, &["payload.json", "report.html"]);
    }
    drop(progress);
    if args.json {
        words::print_json(&account)?;
    } else {
        let mut text: String = runs.iter().map(|run| summary(run, &loaded.file.joints, account.torque_unit)).collect();
        text.push_str(&words::repairs(&runs.iter().flat_map(|r| r.repairs.clone()).collect::<Vec<_>>()));
        text.push_str(&words::warnings(&warnings));
        words::say(&(text + &files))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// One recording in words.
pub fn summary(run: &PayloadRun, joints: &[String], unit: &str) -> String {
    let mut out = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        out,
        "Payload in {}: {} in {} s; the motion supports the estimate in {} of the time.",
        run.file,
        words::count(run.measured.len(), "payload"),
        significant(run.duration_s, 3),
        percent(run.supported_share)
    );
    if !run.measured.is_empty() {
        let _ = writeln!(
            out,
            "  {:>9} {:>9} {:>18} {:>9}  {:>13} {:>11}",
            "picked", "placed", "mass", "error", "settled after", "zero after"
        );
        run.measured.iter().for_each(|i| out.push_str(&interval(i)));
        let alone = |f: fn(&Interval) -> Option<f64>| {
            let worst = run.simulated.iter().map(f).collect::<Option<Vec<f64>>>()?.into_iter().fold(0.0, f64::max);
            Some(seconds(Some(worst)))
        };
        if let (Some(pick), Some(place)) = (alone(|i| i.settled_after_s), alone(|i| i.zero_after_s)) {
            let _ = writeln!(
                out,
                "  From the simulated torque of the model: settled after at most {pick}, zero after at most {place}."
            );
        }
    }
    let [empty, carried] = &run.table2[..] else { return out };
    let _ = writeln!(
        out,
        "Torque error over it, moving samples [{unit}]  {:>8} μ, σ without payload {:>6} μ, σ with it",
        "", ""
    );
    let width = joints.iter().map(|j| j.chars().count()).max().unwrap_or(0);
    for (j, joint) in joints.iter().enumerate() {
        let get = |list: &[f64]| list.get(j).map_or_else(String::new, |v| format!("{v:.2}"));
        let [a, b, c, d] = [&empty.mean_nm, &empty.std_nm, &carried.mean_nm, &carried.std_nm].map(|l| get(l));
        let _ = writeln!(out, "  {joint:width$}  {a:>10} {b:>10}      {c:>10} {d:>10}");
    }
    out
}

fn interval(i: &Interval) -> String {
    let mass = match (i.mass_kg, i.sd_kg) {
        (Some(mass), Some(sd)) => format!("{mass:.3} ± {:.3} kg", 2.0 * sd),
        (Some(mass), None) => format!("{mass:.3} kg"),
        _ => "not supported".to_owned(),
    };
    let error = i.mass_kg.zip(i.known_kg).map_or_else(String::new, |(m, k)| format!("{:+.1} %", 100.0 * (m / k - 1.0)));
    let at = |t: Option<f64>, never: &str| t.map_or_else(|| never.to_owned(), |t| format!("{t:.3} s"));
    let (picked, placed) = (at(i.picked_s, "before"), at(i.placed_s, "end"));
    format!(
        "  {picked:>9} {placed:>9} {mass:>18} {error:>9}  {:>13} {:>11}\n",
        if i.picked_s.is_some() { seconds(i.settled_after_s) } else { String::new() },
        if i.placed_s.is_some() { seconds(i.zero_after_s) } else { String::new() },
    )
}

fn seconds(t: Option<f64>) -> String {
    t.map_or_else(|| "not".to_owned(), |t| format!("{t:.3} s"))
}
