//! The recorder process: the bus into a file.

use lacuna_interfaces::graph::Mode;
use lacuna_interfaces::{BadInput, RobotFile};
use lacuna_recorder::{Attachment, Before, Config, Lanes, Recorder, Run, before};
use lacuna_stage::{AnyMessage, Resumption, Sink, SinkContext, run_sink};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::thread::JoinHandle;

/// The file is made with the first sample: a run that fails before leaves none, and replaces none.
struct Process {
    config: Config,
    robot: RobotFile,
    lanes: Lanes,
    live: bool,
    attachments: Vec<Attachment>,
    facts: BTreeMap<String, String>,
    recorder: Option<Recorder>,
    /// True if the file is this process's: there was none before.
    own_file: bool,
    resumed: bool,
    /// Looks at the files of the recorders that died, which may be long.
    looking: Option<JoinHandle<Before>>,
    resumption: Resumption,
}

impl Process {
    /// Takes over what was found in the files of the recorders that died.
    fn settle(&mut self) -> Result<(), String> {
        let Some(before) = self.looking.take().map(JoinHandle::join) else { return Ok(()) };
        let before = before.map_err(|_| "the files before this one could not be looked at".to_owned())?;
        self.resumption.last_seq = u64::from(before.furthest());
        if let Some(recorder) = &mut self.recorder {
            self.resumption.while_down = recorder.continues(&before).map_err(|e| e.to_string())?;
        }
        Ok(())
    }

    /// On a full disk a file is begun and gets no byte; a recorder that is started again and again would leave thousands.
    fn discard_empty(&self) {
        let file = self.config.file_at(self.config.path.clone());
        if self.own_file && std::fs::metadata(&file).is_ok_and(|m| m.is_file() && m.len() == 0) {
            let _ = std::fs::remove_file(&file);
        }
    }

    fn recorder(&mut self) -> Result<&mut Recorder, String> {
        if self.recorder.is_none() {
            let run = Run {
                robot: &self.robot,
                streams: &self.lanes.streams,
                branches: &self.lanes.branches,
                resumed: self.resumed,
                live: self.live,
                attachments: std::mem::take(&mut self.attachments),
                facts: std::mem::take(&mut self.facts),
            };
            self.own_file = !self.config.path.exists();
            let recorder = Recorder::new(&self.config, &run);
            self.recorder = Some(recorder.inspect_err(|_| self.discard_empty()).map_err(|e| e.to_string())?);
        }
        self.recorder.as_mut().ok_or_else(|| "no recorder".to_owned())
    }
}

/// `run.mcap` → `run-restart2.mcap`: a recorder that was killed goes on in a new file, the first of its name.
fn numbered(path: &Path, n: u32) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map(|e| format!(".{}", e.to_string_lossy())).unwrap_or_default();
    path.with_file_name(format!("{stem}-restart{n}{extension}"))
}

/// What the recorders of `run` before this one left behind, in their order: the first has `path`, those after it a number
/// below `free`. Files of other runs may stand between.
fn left_behind(config: &Config, path: &Path, free: u32, run: &str) -> Before {
    let names = std::iter::once(path.to_path_buf()).chain((1..free).map(|n| numbered(path, n)));
    before(names.map(|p| config.file_at(p)), run)
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
        let mut looking = None;
        if context.restarts > 0 {
            let path = std::mem::take(&mut config.path);
            // A file of an earlier run is not in the way: this run must go on.
            let free = (context.restarts..u32::MAX).find(|n| !numbered(&path, *n).exists()).unwrap_or(u32::MAX);
            config.path = numbered(&path, free);
            let (config, run) = (config.clone(), context.run.to_owned());
            looking = Some(std::thread::spawn(move || left_behind(&config, &path, free, &run)));
        }
        let live = context.mode == Mode::Live;
        config.check(live).map_err(|e| BadInput::new(e.to_string()))?;
        let lanes = Lanes::of(context.topics)?;
        Ok(Self {
            robot: context.robot.clone(),
            lanes,
            live,
            attachments: attachments(context)?,
            facts: [
                ("graph", context.graph.name.as_str()),
                ("torque_unit", context.robot.torque_unit.symbol()),
                ("run", context.run),
            ]
            .map(|(key, value)| (key.to_owned(), value.to_owned()))
            .into(),
            config,
            recorder: None,
            own_file: false,
            resumed: context.restarts > 0,
            looking,
            resumption: Resumption::default(),
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

    fn idle(&mut self) {
        // By now every stream that is alive has sent something.
        if self.looking.as_ref().is_some_and(JoinHandle::is_finished)
            && self.recorder.as_ref().is_some_and(Recorder::has_begun)
            && let Err(e) = self.settle()
        {
            tracing::warn!("{e}");
        }
    }

    fn unkept(&self) -> u64 {
        self.recorder.as_ref().map_or(0, Recorder::unwritten)
    }

    fn resumption(&mut self) -> Resumption {
        if let Err(e) = self.settle() {
            tracing::warn!("{e}");
        }
        let last_seq = self.recorder.as_ref().map_or(0, Recorder::last_seq);
        Resumption { last_seq: self.resumption.last_seq.max(last_seq), ..self.resumption }
    }

    fn finish(mut self, complete: bool) -> Result<serde_json::Value, String> {
        let path = self.config.path.display().to_string();
        if !complete {
            // Dropping the recorder writes what it holds, without the mark of a complete file.
            drop(self.recorder.take());
            self.discard_empty();
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
