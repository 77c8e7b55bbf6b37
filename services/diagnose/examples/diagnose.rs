//! `diagnose --robot robot.toml --out DIR RECORDINGS…`: the library on files, as the command line has it.

use anyhow::{Context, bail};
use lacuna_diagnose::{Conditioning, Options, diagnose};
use lacuna_recording::{load_robot, read_all};
use std::path::PathBuf;

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1).peekable();
    if args.peek().is_some_and(|a| a == "diagnose") {
        args.next();
    }
    let (mut robot, mut out, mut files, mut sim) = (None, None, Vec::new(), Vec::new());
    let (mut seed, mut verbose, mut in_sim) = (1, false, false);
    let mut conditioning = Conditioning::default();
    while let Some(a) = args.next() {
        let mut value = || args.next().with_context(|| format!("{a}: found nothing; expected a value"));
        match a.as_str() {
            "--robot" => robot = Some(PathBuf::from(value()?)),
            "--out" => out = Some(PathBuf::from(value()?)),
            "--seed" => seed = value()?.parse()?,
            "--band" => conditioning.band_hz = Some(value()?.parse()?),
            "--moving" => conditioning.moving_rad_s = Some(value()?.parse()?),
            "--verbose" => verbose = true,
            "--sim" => in_sim = true,
            _ if in_sim => sim.push(PathBuf::from(a)),
            _ => files.push(PathBuf::from(a)),
        }
    }
    let (Some(robot), Some(out)) = (robot, out) else { bail!("expected --robot FILE --out DIR RECORDINGS…") };
    let loaded = load_robot(&robot)?;
    let read = |files: &[PathBuf]| files.iter().map(|f| read_all(f, &loaded.file)).collect::<Result<Vec<_>, _>>();
    let recordings = read(&files)?;
    conditioning.start_s = start_times(&files);
    let options = Options {
        robot: loaded.file.clone(),
        urdf: loaded.urdf.clone(),
        recordings,
        sim: read(&sim)?,
        conditioning,
        seed,
    };
    let start = std::time::Instant::now();
    let outcome = diagnose(&options, &mut |share, what| {
        if verbose {
            eprintln!("{:6.2} s {:3.0} % {what}", start.elapsed().as_secs_f64(), 100.0 * share);
        }
    })?;
    std::fs::create_dir_all(&out)?;
    std::fs::write(out.join("findings.json"), serde_json::to_string_pretty(&outcome.findings)?)?;
    std::fs::write(out.join("model.toml"), outcome.model.to_toml()?)?;
    println!("{}", outcome.findings.verdict);
    Ok(())
}

/// Start times of a `manifest.json` beside the recordings, if there is one.
fn start_times(files: &[PathBuf]) -> Vec<f64> {
    let manifest = files.first().and_then(|f| f.parent()).map(|d| d.join("manifest.json"));
    let Some(text) = manifest.and_then(|m| std::fs::read_to_string(m).ok()) else { return Vec::new() };
    let Ok(json) = serde_json::from_str::<serde_json::Value>(&text) else { return Vec::new() };
    files
        .iter()
        .map_while(|f| {
            let name = f.file_name()?.to_str()?;
            json["files"].as_array()?.iter().find(|e| e["file"] == name)?["start_time_s"].as_f64()
        })
        .collect()
}
