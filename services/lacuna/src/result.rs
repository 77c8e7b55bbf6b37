//! Results that are done once: a folder with a manifest of what it was made of.
//!
//! `result.json` names command, program, options, and every input and output with its SHA-256. It is written last, and
//! every file appears under its name complete, so a folder with a manifest that holds is a complete result, and one
//! without is not. The same inputs, options and program then give the same result, which need not be made again.

use crate::words;
use lacuna_interfaces::BadInput;
use lacuna_recording::LoadedRobot;
use lacuna_stage::Failure;
use rustix::fs::{FlockOperation, flock};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The manifest's name.
pub const MANIFEST: &str = "result.json";
const SCHEMA: &str = "lacuna.result/1";

/// What a result is made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    schema: String,
    command: String,
    version: String,
    /// Hash of the executable: builds of one version may differ.
    program_sha256: String,
    /// Hash of all that the result depends on; the same in every row of `result.parquet`.
    pub set: String,
    options: Value,
    inputs: Vec<Entry>,
    outputs: Vec<Entry>,
}

/// A file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    /// What it is for; empty for outputs.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    role: String,
    /// Name without its folder.
    file: String,
    bytes: u64,
    sha256: String,
}

/// Files and options of a job.
#[derive(Debug)]
pub struct Job {
    manifest: Manifest,
}

impl Job {
    /// Hashes everything the result of `command` depends on: the robot and its URDF, further files with their roles, and
    /// the options.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn new(command: &str, options: Value, robot: &LoadedRobot, files: &[(&str, &Path)]) -> Result<Self, Failure> {
        let mut inputs = vec![entry("robot", &robot.path)?];
        inputs.extend(robot.urdf_path.as_deref().map(|path| entry("urdf", path)).transpose()?);
        for (role, path) in files {
            inputs.push(entry(role, &lacuna_recording::file_of(path)?)?);
        }
        let mut options = options;
        if let (Some(map), Some(ethercat)) = (options.as_object_mut(), &robot.file.ethercat) {
            // Its addresses come from a file of the bus master, which the robot file names.
            let addresses = serde_json::to_value(ethercat).map_err(|e| Failure::run(format!("ethercat: {e}")))?;
            map.insert("ethercat".to_owned(), addresses);
        }
        let mut manifest = Manifest {
            schema: SCHEMA.to_owned(),
            command: command.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            program_sha256: program()?,
            set: String::new(),
            options,
            inputs,
            outputs: Vec::new(),
        };
        let text = serde_json::to_string(&manifest).map_err(|e| Failure::run(format!("{MANIFEST}: {e}")))?;
        manifest.set = hex(&Sha256::digest(text));
        Ok(Self { manifest })
    }

    /// Hash of all that the result depends on.
    pub fn set(&self) -> &str {
        &self.manifest.set
    }

    /// True if `folder` holds the complete result of this job: its manifest says the same, and every file is as it was.
    pub fn is_done(&self, folder: &Path) -> bool {
        let Some(found) = read(folder) else { return false };
        let same = Manifest { outputs: self.manifest.outputs.clone(), ..found.clone() } == self.manifest;
        let intact = |e: &Entry| entry("", &folder.join(&e.file)).is_ok_and(|now| now == *e);
        same && !found.outputs.is_empty() && found.outputs.iter().all(intact)
    }

    /// Begins to write the result into `folder`, which is made if need be.
    ///
    /// # Errors
    /// If the operating system refuses.
    pub fn stage(self, folder: &Path) -> Result<Stage, Failure> {
        let fail = |e: std::io::Error| words::cannot_write(folder, &e);
        std::fs::create_dir_all(folder).map_err(fail)?;
        let lock = File::open(folder).map_err(fail)?;
        // Two that write into one folder do so one after the other.
        flock(&lock, FlockOperation::LockExclusive).map_err(|e| fail(e.into()))?;
        let temp = tempfile::Builder::new().prefix(".partial-").tempdir_in(folder).map_err(fail)?;
        Ok(Stage { manifest: self.manifest, folder: folder.to_path_buf(), temp, _lock: lock })
    }
}

/// A result that is being written, out of sight.
#[derive(Debug)]
pub struct Stage {
    manifest: Manifest,
    folder: PathBuf,
    temp: TempDir,
    _lock: File,
}

impl Stage {
    /// Where its files are written.
    pub fn path(&self) -> &Path {
        self.temp.path()
    }

    /// Puts the files in their place, then the manifest; a file of an earlier result that is none of this one goes.
    /// Returns the files' names.
    ///
    /// # Errors
    /// If the operating system refuses. The folder then has no manifest.
    pub fn commit(mut self) -> Result<Vec<String>, Failure> {
        let folder = self.folder;
        let fail = |e: std::io::Error| words::cannot_write(&folder, &e);
        let mut names: Vec<String> = Vec::new();
        for found in std::fs::read_dir(self.temp.path()).map_err(fail)? {
            names.push(found.map_err(fail)?.file_name().to_string_lossy().into_owned());
        }
        names.sort_unstable();
        let before = read(&folder);
        match std::fs::remove_file(folder.join(MANIFEST)) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(fail(e)),
            _ => {}
        }
        for old in before.into_iter().flat_map(|m| m.outputs).filter(|e| !names.contains(&e.file)) {
            // A name with a folder in it is none of ours.
            if Path::new(&old.file).file_name().is_some_and(|n| n == old.file.as_str()) {
                let _ = std::fs::remove_file(folder.join(&old.file));
            }
        }
        for name in &names {
            let from = self.temp.path().join(name);
            File::open(&from).and_then(|f| f.sync_all()).map_err(fail)?;
            self.manifest.outputs.push(entry("", &from)?);
            std::fs::rename(&from, folder.join(name)).map_err(fail)?;
        }
        let text =
            serde_json::to_string_pretty(&self.manifest).map_err(|e| Failure::run(format!("{MANIFEST}: {e}")))?;
        let from = self.temp.path().join(MANIFEST);
        words::write(&from, (text + "\n").as_bytes())?;
        File::open(&from).and_then(|f| f.sync_all()).map_err(fail)?;
        std::fs::rename(&from, folder.join(MANIFEST)).map_err(fail)?;
        names.push(MANIFEST.to_owned());
        Ok(names)
    }
}

/// What to say of a result that was there already; with `json` its account `account`.
///
/// # Errors
/// If it cannot be printed.
pub fn say_done(folder: &Path, account: &str, json: bool) -> Result<(), Failure> {
    if json {
        return words::say(&lacuna_recording::files::read_text(&folder.join(account))?);
    }
    let names: Vec<String> = read(folder).into_iter().flat_map(|m| m.outputs).map(|e| e.file).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    words::say(&format!(
        "Done already, with the same recordings, options and program: nothing was changed (--force does it again).\n{}",
        words::files(folder, &names)
    ))
}

/// The manifest of a folder, if it has one that can be read.
fn read(folder: &Path) -> Option<Manifest> {
    let text = lacuna_recording::files::read_text(&folder.join(MANIFEST)).ok()?;
    serde_json::from_str(&text).ok()
}

fn entry(role: &str, path: &Path) -> Result<Entry, BadInput> {
    let (bytes, sha256) = hash(path)?;
    let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(Entry { role: role.to_owned(), file, bytes, sha256 })
}

/// Size and SHA-256 of a file.
fn hash(path: &Path) -> Result<(u64, String), BadInput> {
    let fail = |e: std::io::Error| match e.kind() {
        std::io::ErrorKind::NotFound => BadInput::new("found no such file; expected it to exist").in_file(path),
        _ => BadInput::new(format!("cannot be read: {e}")).in_file(path),
    };
    let mut file = File::open(path).map_err(fail)?;
    let mut sha = Sha256::new();
    let mut buffer = vec![0; 1 << 18];
    let mut bytes = 0;
    loop {
        let n = match file.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => n,
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => continue,
            Err(e) => return Err(fail(e)),
        };
        sha.update(buffer.get(..n).unwrap_or(&[]));
        bytes += n as u64;
    }
    Ok((bytes, hex(&sha.finalize())))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, b| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{b:02x}");
        text
    })
}

/// Hash of this executable.
fn program() -> Result<String, Failure> {
    let path = std::env::current_exe().map_err(|e| Failure::run(format!("this program's file: {e}")))?;
    Ok(hash(&path)?.1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot(folder: &Path) -> LoadedRobot {
        let path = folder.join("robot.toml");
        std::fs::write(&path, "kind = \"serial\"\nname = \"arm\"\njoints = [\"a\"]\n[[dh]]\na = 0.1\n").unwrap();
        lacuna_recording::load_robot(&path).unwrap()
    }

    fn job(folder: &Path, seed: u64) -> Job {
        let csv = folder.join("a.csv");
        Job::new("diagnose", serde_json::json!({ "seed": seed }), &robot(folder), &[("recording", &csv)]).unwrap()
    }

    #[test]
    fn only_a_whole_result_of_the_same_job_is_done() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("out");
        let csv = dir.path().join("a.csv");
        std::fs::write(&csv, "t,q1,tau1\n0,0,0\n").unwrap();
        assert!(!job(dir.path(), 1).is_done(&out));
        let stage = job(dir.path(), 1).stage(&out).unwrap();
        std::fs::write(stage.path().join("findings.json"), "{}").unwrap();
        std::fs::write(stage.path().join("more.json"), "{}").unwrap();
        drop(stage);
        assert!(!job(dir.path(), 1).is_done(&out), "what was not committed is no result");
        assert_eq!(std::fs::read_dir(&out).unwrap().count(), 0);

        let write = |seed: u64, files: &[&str]| {
            let stage = job(dir.path(), seed).stage(&out).unwrap();
            files.iter().for_each(|f| std::fs::write(stage.path().join(f), "{}").unwrap());
            stage.commit().unwrap()
        };
        assert_eq!(write(1, &["findings.json", "more.json"]), ["findings.json", "more.json", MANIFEST]);
        assert!(job(dir.path(), 1).is_done(&out));
        assert!(!job(dir.path(), 2).is_done(&out), "other options");
        write(2, &["findings.json"]);
        assert!(job(dir.path(), 2).is_done(&out) && !out.join("more.json").exists());

        std::fs::write(&csv, "t,q1,tau1\n0,0,1\n").unwrap();
        assert!(!job(dir.path(), 2).is_done(&out), "another recording");
        std::fs::write(&csv, "t,q1,tau1\n0,0,0\n").unwrap();
        assert!(job(dir.path(), 2).is_done(&out));
        std::fs::write(out.join("findings.json"), "{").unwrap();
        assert!(!job(dir.path(), 2).is_done(&out), "a file that was changed");
        std::fs::write(out.join("findings.json"), "{}").unwrap();
        std::fs::remove_file(out.join(MANIFEST)).unwrap();
        assert!(!job(dir.path(), 2).is_done(&out), "no manifest");
        std::fs::write(out.join(MANIFEST), "{\"schema\": 1").unwrap();
        assert!(!job(dir.path(), 2).is_done(&out), "half a manifest");
    }

    #[test]
    fn the_hash_is_that_of_the_standard() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("a"), "abc").unwrap();
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(hash(&dir.path().join("a")).unwrap(), (3, expected.to_owned()));
    }
}
