//! Where a part of the proof works: below the user's folder, or in one that is gone afterwards.

use crate::error::{Error, io};
use lacuna_interfaces::BadInput;
use std::path::{Path, PathBuf};

/// A folder for cases and findings.
#[derive(Debug)]
pub struct Workplace {
    path: PathBuf,
    /// Gone with this, if the user keeps nothing.
    _temporary: Option<tempfile::TempDir>,
}

impl Workplace {
    /// `OUT/PART`, or a temporary folder.
    ///
    /// # Errors
    /// If the folder holds something already (findings of another run would be mixed up with this one's), or cannot
    /// be made.
    pub fn new(out: Option<&Path>, part: &str) -> Result<Self, Error> {
        let Some(out) = out else {
            let made = tempfile::Builder::new().prefix("lacuna-prove-").tempdir();
            let dir = made.map_err(|e| Error::Run(format!("temporary folder: cannot be made: {e}")))?;
            return Ok(Self { path: dir.path().to_path_buf(), _temporary: Some(dir) });
        };
        let path = out.join(part);
        if path.exists() && !path.is_dir() {
            return Err(BadInput::new("found a file; expected a folder, or a name that is free").in_file(&path).into());
        }
        std::fs::create_dir_all(&path).map_err(io("made", &path))?;
        if std::fs::read_dir(&path).map_err(io("read", &path))?.next().is_some() {
            return Err(BadInput::new("found files in it; expected an empty or new folder").in_file(&path).into());
        }
        // A diagnosis runs in the case's folder: its output must not be relative to ours.
        let path = path.canonicalize().map_err(io("found", &path))?;
        Ok(Self { path, _temporary: None })
    }

    /// A folder below it, made.
    ///
    /// # Errors
    /// If it cannot be made.
    pub fn folder(&self, name: &str) -> Result<PathBuf, Error> {
        let path = self.path.join(name);
        std::fs::create_dir_all(&path).map_err(io("made", &path))?;
        Ok(path)
    }

    /// Writes a file below it.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, name: &str, text: &str) -> Result<PathBuf, Error> {
        let path = self.path.join(name);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(io("made", folder))?;
        }
        std::fs::write(&path, text).map_err(io("written", &path))?;
        Ok(path)
    }
}
