//! A recording as the folder that `ros2 bag` opens: an MCAP file and `metadata.yaml` beside it.
//!
//! The file of an MCAP is copied byte by byte. Any other recording is written by the recorder itself, as its measured
//! samples.

use crate::file::ExportError;
use lacuna_interfaces::BadInput;
use lacuna_recorder::{Attachment, Config, Recorder, Run, Stream};
use lacuna_recording::container::Compression;
use lacuna_recording::ros::bag::{Topic, metadata_yaml};
use lacuna_recording::{LoadedRobot, ReadOptions, inspect};
use std::path::{Path, PathBuf};

/// A bag that was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bag {
    /// Messages in it.
    pub messages: u64,
    /// Its topics.
    pub topics: Vec<String>,
}

/// Writes a bag folder `to`. With a robot file the recording's samples, as every other command reads them; without one
/// the messages of an MCAP.
///
/// # Errors
/// [`ExportError`] for an existing folder (with `force`: one that is no bag), a recording that cannot be read or is cut
/// off, or a disk that does not take it.
pub fn write(recording: &Path, robot: Option<&LoadedRobot>, to: &Path, force: bool) -> Result<Bag, ExportError> {
    check(to, force)?;
    let io = |action| move |source| ExportError::Io { path: to.to_path_buf(), action, source };
    let name = to.file_name().ok_or_else(|| BadInput::new("found no name for a folder").in_file(to))?;
    let parent = to.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(parent).map_err(io("created"))?;
    // Beside the target, so that giving it its name is one step.
    let work = tempfile::Builder::new()
        .prefix(&format!(".{}.", name.to_string_lossy()))
        .suffix(".partial")
        .tempdir_in(parent)
        .map_err(io("created"))?;
    let folder = work.path().join(name);
    let bag = match robot {
        None => copy(recording, &folder, &name.to_string_lossy()),
        Some(robot) => samples(recording, robot, &folder),
    }?;
    if to.exists() {
        std::fs::rename(to, work.path().join("replaced")).map_err(io("replaced"))?;
    }
    std::fs::rename(&folder, to).map_err(io("completed"))?;
    Ok(bag)
}

/// Whether the folder may be written; only a bag is ever replaced.
fn check(to: &Path, force: bool) -> Result<(), ExportError> {
    if !to.exists() {
        return Ok(());
    }
    if !force {
        return Err(BadInput::new("found an existing folder; expected none, or --force").in_file(to).into());
    }
    let entries = std::fs::read_dir(to).map(|list| list.flatten().map(|e| e.path()).collect::<Vec<PathBuf>>());
    let belongs =
        |p: &PathBuf| p.file_name().is_some_and(|n| n == "metadata.yaml") || p.extension().is_some_and(|e| e == "mcap");
    match entries {
        Ok(list) if list.iter().all(belongs) && to.join("metadata.yaml").is_file() => Ok(()),
        _ => Err(BadInput::new("found something that is no bag folder; expected one, as --force replaces bags only")
            .in_file(to)
            .into()),
    }
}

fn copy(recording: &Path, folder: &Path, name: &str) -> Result<Bag, ExportError> {
    if !lacuna_recording::is_mcap(recording)? {
        let what = "found a recording that is no MCAP; expected --robot FILE, which says what its columns are";
        return Err(BadInput::new(what).in_file(recording).into());
    }
    let from = lacuna_recording::file_of(recording)?;
    let info = inspect(&from)?;
    if info.was_cut {
        let what = "found a file that stops before its end; expected a whole one (lacuna recover completes it)";
        return Err(BadInput::new(what).in_file(&from).into());
    }
    let io = |action| move |source| ExportError::Io { path: folder.to_path_buf(), action, source };
    std::fs::create_dir(folder).map_err(io("created"))?;
    let file = format!("{name}_0.mcap");
    std::fs::copy(&from, folder.join(&file)).map_err(io("written"))?;
    let topics: Vec<Topic> = info
        .topics
        .iter()
        // What is not CDR is in the file, but no ROS tool reads it.
        .filter(|(_, t)| t.encoding == "cdr")
        .map(|(name, t)| Topic { name: name.clone(), kind: t.schema.clone(), count: t.messages })
        .collect();
    let times = info.topics.values().filter(|t| t.encoding == "cdr").filter_map(|t| t.times);
    let (start, end) = times.reduce(|(a, b), (c, d)| (a.min(c), b.max(d))).unwrap_or((0, 0));
    let text = metadata_yaml(&file, start, end, &topics);
    std::fs::write(folder.join("metadata.yaml"), text).map_err(io("written"))?;
    Ok(Bag { messages: topics.iter().map(|t| t.count).sum(), topics: topics.into_iter().map(|t| t.name).collect() })
}

fn samples(recording: &Path, robot: &LoadedRobot, folder: &Path) -> Result<Bag, ExportError> {
    let mut reader = lacuna_recording::open_with(recording, &robot.file, &ReadOptions::default())?;
    let config = Config {
        path: folder.to_path_buf(),
        compression: Compression::Zstd,
        level: 1,
        chunk_kib: 1024,
        queue_chunks: 8,
        flush_s: 0.5,
        // Synced once, at the end.
        sync_s: 0.0,
        overwrite: false,
        bag: true,
    };
    let texts =
        [("robot.toml", "application/toml", Some(&robot.toml)), ("robot.urdf", "application/xml", robot.urdf.as_ref())];
    let attachments = texts.into_iter().filter_map(|(name, media_type, text)| {
        let data = text?.as_bytes().to_vec();
        Some(Attachment { name: name.to_owned(), media_type: media_type.to_owned(), data })
    });
    let source = reader.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
    let run = Run {
        robot: &robot.file,
        streams: &[Stream::Measured],
        branches: &[],
        resumed: false,
        live: false,
        attachments: attachments.collect(),
        facts: [("source".to_owned(), source)].into(),
    };
    let mut recorder = Recorder::new(&config, &run)?;
    while let Some(sample) = reader.next_sample()? {
        recorder.lane(0)?.measured(&sample.measured)?;
    }
    let counts = recorder.finish()?;
    let messages = counts.messages.values().sum();
    Ok(Bag { messages, topics: counts.messages.into_keys().collect() })
}
