//! Robots of the simulated tests; where the shared recordings are, and options for them.

#![allow(dead_code, reason = "every test file uses its part")]

use lacuna_identify::{FileRange, Options};
use std::path::PathBuf;

/// A Delta.
pub const DELTA: &str = "kind = \"delta\"\nname = \"test\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n[mass]\n\
    platform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\nrotor_inertia = 0.06\n[drive]\ngear_ratio = 33\n\
    encoder_bits = 20\nsample_rate_hz = 1000\n";

/// A planar arm of two joints, standing on its side so that gravity is felt at both.
pub const ARM: &str = "kind = \"serial\"\nname = \"arm\"\njoints = [\"a\", \"b\"]\n[env]\ngravity = [9.81, 0.0, 0.0]\n\
    [[dh]]\na = 0.3\n[[dh]]\na = 0.25\n\
    [[link]]\nmass = 2.0\ncom = [-0.1, 0.0, 0.0]\ninertia = [0.01, 0.0, 0.0, 0.02, 0.0, 0.02]\nrotor_inertia = 0.1\n\
    [[link]]\nmass = 1.5\ncom = [-0.1, 0.0, 0.0]\ninertia = [0.01, 0.0, 0.0, 0.015, 0.0, 0.015]\nrotor_inertia = 0.05\n\
    [drive]\ngear_ratio = 50\nencoder_bits = 20\nsample_rate_hz = 1000\n";

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
