//! Replay throughput of the whole graph as a ratio to the bare chain, run in turns.

use crate::chain::{bare, graph};
use crate::{BenchError, launch_file, median, motion};
use serde::{Deserialize, Serialize};
use std::path::Path;

const NODES: [&str; 6] = ["source", "smoother", "torque", "friction", "payload", "monitor"];

/// One way to run the graph.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Row {
    /// What was run.
    pub what: String,
    /// Median samples per second.
    pub rate_per_s: f64,
    /// Median of the ratios to the bare chain of the same turn.
    pub ratio_to_bare: f64,
    /// Smallest and largest ratio.
    pub ratio_range: [f64; 2],
}

/// Runs `turns` turns of bare chain and every variant of the graph over `samples` samples.
///
/// # Errors
/// If a run fails or loses samples.
pub fn run(launch: &Path, samples: u64, turns: usize, progress: &mut dyn FnMut(&str)) -> Result<Vec<Row>, BenchError> {
    let full = launch.join("replay.toml");
    let text = launch_file(&full)?;
    let dir = tempfile::tempdir()?;
    let file = |name: &str| dir.path().join(name);
    std::fs::write(file("robot.toml"), motion::ROBOT)?;
    std::fs::write(file("model.toml"), motion::MODEL)?;
    progress("writing the recording");
    motion::write_csv(&file("run.csv"), samples, 1000.0)?;
    let without = file("without-recorder.toml");
    std::fs::write(&without, without_recorder(&text))?;
    let variants = [
        ("without recorder", &without, "zstd"),
        ("recorder, zstd", &full, "zstd"),
        ("recorder, lz4", &full, "lz4"),
        ("recorder, no compression", &full, "none"),
    ];
    let mut bare_rates = Vec::new();
    let mut rates = vec![Vec::new(); variants.len()];
    for turn in 1..=turns {
        progress(&format!("turn {turn} of {turns}: bare chain"));
        bare_rates.push(bare(NODES.len(), samples, 512, 0)?.rate());
        for (i, (what, path, compression)) in variants.iter().enumerate() {
            progress(&format!("turn {turn} of {turns}: {what}"));
            let text = |name: &str| file(name).display().to_string();
            let sets = [
                ("recording", text("run.csv")),
                ("robot", text("robot.toml")),
                ("model", text("model.toml")),
                ("out", text("run.mcap")),
                ("overwrite", "true".to_owned()),
                ("compression", (*compression).to_owned()),
            ];
            let report = graph(path, &sets)?;
            if report["samples"].as_u64() != Some(samples) || report["lost"].as_u64() != Some(0) {
                return Err(
                    format!("{what}: {} of {samples} samples, {} lost", report["samples"], report["lost"]).into()
                );
            }
            rates[i].push(samples as f64 / report["seconds"].as_f64().unwrap_or(f64::NAN));
        }
    }
    let mut rows = vec![Row {
        what: format!("bare iceoryx2 chain, {} processes", NODES.len()),
        rate_per_s: median(&mut bare_rates.clone()),
        ratio_to_bare: 1.0,
        ratio_range: [1.0, 1.0],
    }];
    for ((what, ..), rates) in variants.iter().zip(rates) {
        let mut ratios: Vec<f64> = rates.iter().zip(&bare_rates).map(|(r, b)| r / b).collect();
        let ratio = median(&mut ratios);
        rows.push(Row {
            what: (*what).to_owned(),
            rate_per_s: median(&mut rates.clone()),
            ratio_to_bare: ratio,
            ratio_range: [ratios[0], ratios[ratios.len() - 1]],
        });
    }
    Ok(rows)
}

/// The graph file up to its recorder node.
fn without_recorder(text: &str) -> String {
    let head = text.split("[[node]]\nname = \"recorder\"").next().unwrap_or(text);
    head.to_owned()
}
