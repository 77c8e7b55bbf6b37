//! Where the shared recordings are, and options for them.

#![allow(dead_code, reason = "every test file uses its part")]

use lacuna_identify::{FileRange, Options};
use std::path::PathBuf;

/// The folder of real recordings: `LACUNA_SHARED_DATA`, else `shared/data` beside the workspace. `None`, said aloud,
/// where it is absent.
pub fn shared(folder: &str) -> Option<PathBuf> {
    let root = std::env::var_os("LACUNA_SHARED_DATA")
        .map(PathBuf::from)
        .unwrap_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"));
    let path = root.join(folder);
    if path.is_dir() {
        return Some(path);
    }
    eprintln!("SKIPPED: {} is absent", path.display());
    None
}

/// Files of `folder` whose name contains `part`, sorted.
pub fn files(folder: &std::path::Path, part: &str) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| {
            p.extension().is_some_and(|e| e == "csv") && p.file_name().unwrap().to_str().unwrap().contains(part)
        })
        .collect();
    found.sort();
    found
}

/// Options of a robot in `folder` at a band.
pub fn options(folder: &std::path::Path, band_hz: f64) -> Options {
    let mut options = Options { robot: folder.join("robot.toml"), ..Options::default() };
    options.conditioning.band_hz = Some(band_hz);
    options
}

/// A part of a file.
pub fn part(file: impl Into<PathBuf>, from_s: f64, to_s: f64) -> FileRange {
    FileRange { file: file.into(), from_s: Some(from_s), to_s: Some(to_s) }
}

/// A whole file.
pub fn whole(file: impl Into<PathBuf>) -> FileRange {
    FileRange { file: file.into(), from_s: None, to_s: None }
}
