//! The recorder process: the bus into a file.

use lacuna_interfaces::graph::Mode;
use lacuna_interfaces::{BadInput, RobotFile};
use lacuna_recorder::{Attachment, Config, Lanes, Recorder, Run};
use lacuna_stage::{AnyMessage, Sink, SinkContext, run_sink};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// The file is made with the first sample: a run that fails before leaves none, and replaces none.
struct Process {
    config: Config,
    robot: RobotFile,
    lanes: Lanes,
    live: bool,
    attachments: Vec<Attachment>,
    facts: BTreeMap<String, String>,
    recorder: Option<Recorder>,
}

impl Process {
    fn recorder(&mut self) -> Result<&mut Recorder, String> {
        if self.recorder.is_none() {
            let run = Run {
                robot: &self.robot,
                streams: &self.lanes.streams,
                branches: &self.lanes.branches,
                live: self.live,
                attachments: std::mem::take(&mut self.attachments),
                facts: std::mem::take(&mut self.facts),
            };
            self.recorder = Some(Recorder::new(&self.config, &run).map_err(|e| e.to_string())?);
        }
        self.recorder.as_mut().ok_or_else(|| "no recorder".to_owned())
    }
}

/// `run.mcap` → `run-restart2.mcap`: a recorder that was killed goes on in a new file, the first of its name.
fn numbered(path: &Path, restarts: u32) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map(|e| format!(".{}", e.to_string_lossy())).unwrap_or_default();
    let name = |n: u32| path.with_file_name(format!("{stem}-restart{n}{extension}"));
    // A file of an earlier run is not in the way: this run must go on.
    (restarts..u32::MAX).map(name).find(|p| !p.exists()).unwrap_or_else(|| name(restarts))
}

fn attachments(context: &SinkContext<'_>) -> Result<Vec<Attachment>, BadInput> {
    let graph = toml::to_string(context.graph).map_err(|e| BadInput::new(format!("graph: {e}")))?;
    let files = [
        ("robot.toml", "application/toml", Some(context.robot_text)),
        ("robot.urdf", "application/xml", context.urdf),
        ("model.toml", "application/toml", context.model_text),
        ("graph.toml", "application/toml", Some(&graph)),
    ];
    let attach = |(name, media_type, text): (&str, &str, Option<&str>)| {
        text.map(|text| Attachment {
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: text.as_bytes().to_vec(),
        })
    };
    let mut all: Vec<Attachment> = files.into_iter().filter_map(attach).collect();
    for (space, text) in context.branch_models {
        all.extend(attach((&format!("model-{space}.toml"), "application/toml", Some(text))));
    }
    Ok(all)
}

impl Sink for Process {
    type Config = Config;

    fn new(mut config: Config, context: &SinkContext<'_>) -> Result<Self, BadInput> {
        if context.restarts > 0 {
            config.path = numbered(&config.path, context.restarts);
        }
        let live = context.mode == Mode::Live;
        config.check(live).map_err(|e| BadInput::new(e.to_string()))?;
        let lanes = Lanes::of(context.topics)?;
        Ok(Self {
            robot: context.robot.clone(),
            lanes,
            live,
            attachments: attachments(context)?,
            facts: [("graph", context.graph.name.as_str()), ("torque_unit", context.robot.torque_unit.symbol())]
                .map(|(key, value)| (key.to_owned(), value.to_owned()))
                .into(),
            config,
            recorder: None,
        })
    }

    fn take(&mut self, topic: &str, message: AnyMessage<'_>, _missing: u64) -> Result<(), String> {
        let index = self.lanes.index_of(topic);
        let mut recorder = self.recorder()?.lane(index).map_err(|e| e.to_string())?;
        match message {
            AnyMessage::JointMeasured(m) => recorder.measured(m),
            AnyMessage::JointSmoothed(m) => recorder.smoothed(m),
            AnyMessage::TorqueModel(m) => recorder.torque(m),
            AnyMessage::FrictionTorque(m) => recorder.friction(m),
            AnyMessage::PayloadEstimate(m) => recorder.payload(m),
            AnyMessage::ResidualWatch(m) => recorder.watch(m),
        }
        .map_err(|e| e.to_string())
    }

    fn idle(&mut self) {}

    fn finish(mut self, complete: bool) -> Result<serde_json::Value, String> {
        let path = self.config.path.display().to_string();
        if !complete {
            // Dropping the recorder writes what it holds, without the mark of a complete file.
            return Ok(serde_json::json!({ "path": path, "complete": false }));
        }
        if self.lanes.streams.is_empty() && self.lanes.branches.is_empty() {
            // Started again when all streams had ended.
            return Ok(serde_json::json!({ "path": null, "complete": true }));
        }
        self.recorder()?;
        let Some(recorder) = self.recorder.take() else { return Err("no recorder".to_owned()) };
        let counts = recorder.finish().map_err(|e| e.to_string())?;
        Ok(serde_json::json!({
            "path": path, "complete": true, "samples": counts.samples, "messages": counts.messages, "dropped": counts.dropped,
        }))
    }
}

fn main() -> ExitCode {
    run_sink::<Process>()
}
