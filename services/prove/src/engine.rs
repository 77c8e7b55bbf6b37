//! Concealed, other engine: Delta recordings with keys that were made by code which is not this project's.

use crate::error::{Error, io};
use crate::hidden::Hidden;
use crate::score::{self, judge};
use crate::section::Section;
use crate::{Options, Part, Watcher, Workplace, concealed};
use lacuna_recording::files::read_text;

const TITLE: &str = "Concealed, other engine";

/// Diagnoses every case of `SHARED/data/delta_concealed` and holds the findings against its key.
///
/// # Errors
/// [`Error`] if a case or a key cannot be read.
pub fn prove(options: &Options, watcher: &mut dyn Watcher) -> Result<Section, Error> {
    let dir = options.shared.join("data/delta_concealed");
    let cases = dir.join("cases");
    if !cases.is_dir() {
        return Ok(Section::skipped(Part::Engine, TITLE, options, format!("no recordings at {}", dir.display())));
    }
    let place = Workplace::new(options.out.as_deref(), "engine")?;
    let entries = std::fs::read_dir(&cases).map_err(io("read", &cases))?;
    let mut names: Vec<String> = entries.flatten().filter_map(|e| e.file_name().into_string().ok()).collect();
    names.sort();
    names.truncate(options.cases.unwrap_or(usize::MAX));
    let mut answers = Vec::new();
    for (k, name) in names.iter().enumerate() {
        watcher.at(k as f64 / names.len() as f64, &format!("{name} ({} of {})", k + 1, names.len()));
        let folder = cases.join(name);
        let folder = folder.canonicalize().map_err(io("found", &folder))?;
        let findings = place.folder(&format!("findings/{name}"))?;
        answers.push(options.diagnosis.run(&folder, "robot.toml", &concealed::recordings(&folder)?, &findings)?);
    }
    let mut judged = Vec::new();
    for (name, answered) in names.iter().zip(&answers) {
        let path = dir.join("keys").join(format!("{name}.json"));
        let hidden = Hidden::of_key(&read_text(&path)?).map_err(|e| e.in_file(&path))?;
        judged.push(judge(name, &hidden, answered));
    }
    let mut section = Section {
        part: Part::Engine.name().to_owned(),
        title: TITLE.to_owned(),
        command: options.command(Part::Engine),
        conditions: vec![
            format!(
                "{} Delta cases of {} (closed loop at 4 kHz, 6 recordings of 5 s at 1 kHz), by an engine that shares no code \
                 with this project.",
                names.len(),
                "delta_concealed"
            ),
            "These cases were open during development: they show that another engine's recordings are read right, not \
             how new ones fare."
                .to_owned(),
        ],
        ..Section::default()
    };
    score::section(&mut section, &judged);
    Ok(section)
}
