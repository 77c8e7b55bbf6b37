//! New files that appear under their name only when they are complete.

use lacuna_interfaces::BadInput;
use lacuna_recording::container::WriteError;
use std::fs::{File, Permissions};
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// Why an export failed.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// What was asked for cannot be done.
    #[error(transparent)]
    Refused(#[from] BadInput),
    /// The operating system said no.
    #[error("{}cannot be {action}: {source}", place(path))]
    Io {
        /// The file; empty if it has no name yet.
        path: PathBuf,
        /// What was tried (`created`, `written`, …).
        action: &'static str,
        /// Its reason.
        source: io::Error,
    },
    /// The Parquet library said no.
    #[error("{}cannot be written: {source}", place(path))]
    Parquet {
        /// The file; empty if it has no name yet.
        path: PathBuf,
        /// Its reason.
        source: parquet::errors::ParquetError,
    },
    /// The recorder that writes bags said no.
    #[error(transparent)]
    Recorder(#[from] WriteError),
}

/// `FILE: `, or nothing.
fn place(path: &Path) -> String {
    if path.as_os_str().is_empty() { String::new() } else { format!("{}: ", path.display()) }
}

impl ExportError {
    /// Writing failed, the file is named later.
    pub(crate) fn write(source: io::Error) -> Self {
        Self::Io { path: PathBuf::new(), action: "written", source }
    }

    /// The same error, said of `file`, if none was named yet.
    #[must_use]
    pub(crate) fn in_file(self, file: &Path) -> Self {
        match self {
            Self::Io { path, action, source } if path.as_os_str().is_empty() => {
                Self::Io { path: file.to_path_buf(), action, source }
            }
            Self::Parquet { path, source } if path.as_os_str().is_empty() => {
                Self::Parquet { path: file.to_path_buf(), source }
            }
            Self::Refused(bad) => Self::Refused(bad.in_file(file)),
            other => other,
        }
    }
}

impl From<parquet::errors::ParquetError> for ExportError {
    fn from(source: parquet::errors::ParquetError) -> Self {
        Self::Parquet { path: PathBuf::new(), source }
    }
}

/// A file that is being written under another name in the same folder. Dropped before [`NewFile::commit`] it vanishes.
#[derive(Debug)]
pub struct NewFile {
    path: PathBuf,
    folder: PathBuf,
    temp: NamedTempFile,
    replace: bool,
}

impl NewFile {
    /// Begins a file; its folder is made if need be.
    ///
    /// # Errors
    /// [`ExportError`] if it exists and is not to be replaced, is a folder, or cannot be created.
    pub fn create(path: &Path, replace: bool) -> Result<Self, ExportError> {
        if path.is_dir() {
            return Err(BadInput::new("found a folder; expected a file name").in_file(path).into());
        }
        if path.exists() && !replace {
            return Err(exists(path).into());
        }
        let folder = match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder.to_path_buf(),
            _ => PathBuf::from("."),
        };
        let io = |action| move |source| ExportError::Io { path: path.to_path_buf(), action, source };
        std::fs::create_dir_all(&folder).map_err(io("created"))?;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let temp = tempfile::Builder::new()
            .prefix(&format!(".{name}."))
            .suffix(".partial")
            // As any new file: what the user's mask leaves.
            .permissions(Permissions::from_mode(0o666))
            .tempfile_in(&folder)
            .map_err(io("created"))?;
        Ok(Self { path: path.to_path_buf(), folder, temp, replace })
    }

    /// A handle to write with.
    ///
    /// # Errors
    /// [`ExportError`] if the system has no handle left.
    pub fn file(&self) -> Result<File, ExportError> {
        let io = |source| ExportError::Io { path: self.path.clone(), action: "created", source };
        self.temp.as_file().try_clone().map_err(io)
    }

    /// The folder that it will be in.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Gives the file its name, with its content safely on the disk; returns its size [bytes].
    ///
    /// # Errors
    /// [`ExportError`] if it has come into being meanwhile, or the disk refuses.
    pub fn commit(self) -> Result<u64, ExportError> {
        let io = |source| ExportError::Io { path: self.path.clone(), action: "completed", source };
        self.temp.as_file().sync_all().map_err(io)?;
        let bytes = self.temp.as_file().metadata().map_err(io)?.len();
        let done = if self.replace { self.temp.persist(&self.path) } else { self.temp.persist_noclobber(&self.path) };
        match done {
            Ok(_) => Ok(bytes),
            Err(e) if e.error.kind() == io::ErrorKind::AlreadyExists => Err(exists(&self.path).into()),
            Err(e) => Err(ExportError::Io { path: self.path, action: "completed", source: e.error }),
        }
    }
}

pub(crate) fn exists(path: &Path) -> BadInput {
    BadInput::new("found an existing file; expected none, or --force").in_file(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn a_file_has_its_name_only_when_complete() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("sub/a.csv");
        let names = || std::fs::read_dir(path.parent().unwrap()).unwrap().count();
        let new = NewFile::create(&path, false).unwrap();
        new.file().unwrap().write_all(b"half").unwrap();
        assert!(!path.exists());
        drop(new);
        assert_eq!(names(), 0, "what was not completed leaves nothing");
        let write = |replace: bool, text: &str| {
            let new = NewFile::create(&path, replace)?;
            new.file()?.write_all(text.as_bytes()).unwrap();
            new.commit()
        };
        assert_eq!(write(false, "one").unwrap(), 3);
        let e = write(false, "two").unwrap_err().to_string();
        assert!(e.contains("a.csv: found an existing file") && e.contains("--force"), "{e}");
        write(true, "three").unwrap();
        assert_eq!((std::fs::read_to_string(&path).unwrap().as_str(), names()), ("three", 1));
        // Made by somebody else in between.
        let other = dir.path().join("b.csv");
        let new = NewFile::create(&other, false).unwrap();
        std::fs::write(&other, "theirs").unwrap();
        assert!(new.commit().unwrap_err().to_string().contains("existing"));
        assert_eq!(std::fs::read_to_string(&other).unwrap(), "theirs");
        assert!(NewFile::create(dir.path(), true).is_err(), "a folder is not a file name");
    }
}
