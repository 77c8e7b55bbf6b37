//! Which rows train and which test.

use crate::rows::Rows;
use lacuna_interfaces::BadInput;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::str::FromStr;

/// A recording, or a part of it: `FILE` or `FILE@from:to` in seconds of the recording's own time; either end may be
/// left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileRange {
    /// The file.
    pub file: PathBuf,
    /// Start [s].
    #[serde(default)]
    pub from_s: Option<f64>,
    /// End [s].
    #[serde(default)]
    pub to_s: Option<f64>,
}

impl FromStr for FileRange {
    type Err = BadInput;

    fn from_str(text: &str) -> Result<Self, BadInput> {
        let whole = || Self { file: PathBuf::from(text), from_s: None, to_s: None };
        let Some((file, range)) = text.rsplit_once('@') else { return Ok(whole()) };
        let Some((from, to)) = range.split_once(':') else { return Ok(whole()) };
        let bound = |s: &str| -> Result<Option<f64>, BadInput> {
            if s.is_empty() {
                return Ok(None);
            }
            match s.parse::<f64>() {
                Ok(v) if v.is_finite() => Ok(Some(v)),
                _ => Err(BadInput::new(format!(
                    "range of \"{text}\": found \"{s}\"; expected seconds, as in FILE@0:5.4"
                ))),
            }
        };
        let (from_s, to_s) = (bound(from)?, bound(to)?);
        if let (Some(a), Some(b)) = (from_s, to_s)
            && a >= b
        {
            return Err(BadInput::new(format!("range of \"{text}\": found {a} to {b} s; expected from below to")));
        }
        Ok(Self { file: PathBuf::from(file), from_s, to_s })
    }
}

/// How rows are held out of the fit that predicts them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Holdout {
    /// Every recording in turn.
    Recordings,
    /// Both halves of every recording's time, in turn.
    Halves,
    /// Every N-th of every recording's time, in turn.
    Kfold(usize),
}

impl FromStr for Holdout {
    type Err = BadInput;

    fn from_str(text: &str) -> Result<Self, BadInput> {
        let count = text.strip_prefix("kfold=").map(str::parse::<usize>);
        match (text, count) {
            ("recordings", _) => Ok(Self::Recordings),
            ("halves", _) => Ok(Self::Halves),
            (_, Some(Ok(n))) if (2..=1000).contains(&n) => Ok(Self::Kfold(n)),
            _ => Err(BadInput::new(format!(
                "holdout: found \"{text}\"; expected recordings, halves or kfold=N with N from 2 to 1000"
            ))),
        }
    }
}

/// A stretch of time of one recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TimeRange {
    /// File name of the recording.
    pub file: String,
    /// Start [s].
    pub from_s: f64,
    /// End [s].
    pub to_s: f64,
}

/// Rows that train and rows that test.
#[derive(Debug, Clone, PartialEq)]
pub struct Fold {
    /// `train[row]`.
    pub train: Vec<bool>,
    /// `test[row]`.
    pub test: Vec<bool>,
}

/// A range of one recording by its index.
#[derive(Debug, Clone, PartialEq)]
pub struct Span {
    /// Recording.
    pub recording: usize,
    /// Start [s].
    pub from_s: f64,
    /// End [s].
    pub to_s: f64,
}

/// Rows within any of `spans`.
pub fn select(rows: &Rows, spans: &[Span]) -> Vec<bool> {
    (0..rows.len())
        .map(|k| {
            let t = rows.time_s[k];
            spans.iter().any(|s| s.recording == rows.recording[k] && s.from_s <= t && t <= s.to_s)
        })
        .collect()
}

/// The folds of a holdout over all rows. `gap_s` around a boundary within a recording belongs to neither side: there the
/// filter mixes both.
///
/// # Errors
/// [`BadInput`] if there are fewer recordings than folds need.
pub fn folds(rows: &Rows, holdout: Holdout, recordings: usize, gap_s: f64) -> Result<Vec<Fold>, BadInput> {
    let parts = match holdout {
        Holdout::Recordings => {
            if recordings < 2 {
                return Err(BadInput::new(format!(
                    "holdout: found {recordings} recording; expected at least 2 to hold one out (or use halves)"
                )));
            }
            return Ok((0..recordings)
                .map(|r| {
                    let test: Vec<bool> = rows.recording.iter().map(|k| *k == r).collect();
                    Fold { train: test.iter().map(|t| !t).collect(), test }
                })
                .filter(|fold| fold.test.contains(&true))
                .collect());
        }
        Holdout::Halves => 2,
        Holdout::Kfold(n) => n.max(2),
    };
    let mut extent = vec![(f64::INFINITY, f64::NEG_INFINITY); recordings];
    for (&r, &t) in rows.recording.iter().zip(&rows.time_s) {
        extent[r] = (extent[r].0.min(t), extent[r].1.max(t));
    }
    Ok((0..parts)
        .map(|part| {
            let side = |k: usize, margin: f64| {
                let (from, to) = extent[rows.recording[k]];
                let width = (to - from) / parts as f64;
                // The very ends have no neighbour to keep away from.
                let low = if part == 0 { f64::NEG_INFINITY } else { from + part as f64 * width - margin };
                let high = if part + 1 == parts { f64::INFINITY } else { from + (part + 1) as f64 * width + margin };
                (low..=high).contains(&rows.time_s[k])
            };
            Fold {
                train: (0..rows.len()).map(|k| !side(k, 0.5 * gap_s)).collect(),
                test: (0..rows.len()).map(|k| side(k, -0.5 * gap_s)).collect(),
            }
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_parse() {
        let r: FileRange = "a@b/c.csv@0:5.4".parse().unwrap();
        assert_eq!((r.file.to_str(), r.from_s, r.to_s), (Some("a@b/c.csv"), Some(0.0), Some(5.4)));
        let r: FileRange = "a.csv@5:".parse().unwrap();
        assert_eq!((r.from_s, r.to_s), (Some(5.0), None));
        let r: FileRange = "me@home.csv".parse().unwrap();
        assert_eq!(r.file.to_str(), Some("me@home.csv"));
        for bad in ["a.csv@x:1", "a.csv@2:1", "a.csv@nan:2"] {
            let e = bad.parse::<FileRange>().unwrap_err().to_string();
            assert!(e.contains(bad), "{e}");
        }
        assert_eq!("kfold=5".parse(), Ok(Holdout::Kfold(5)));
        assert!("kfold=1".parse::<Holdout>().is_err() && "third".parse::<Holdout>().is_err());
    }

    #[test]
    fn folds_partition_time() {
        let rows = Rows {
            time_s: (0..100).map(|k| (k % 50) as f64).collect(),
            recording: (0..100).map(|k| k / 50).collect(),
            ..Rows::default()
        };
        let halves = folds(&rows, Holdout::Halves, 2, 4.0).unwrap();
        assert_eq!(halves.len(), 2);
        for k in 0..100 {
            let tested: usize = halves.iter().map(|f| usize::from(f.test[k])).sum();
            let near = (rows.time_s[k] - 24.5).abs() < 2.0;
            assert_eq!(tested, usize::from(!near), "row {k}");
            assert!(!halves.iter().any(|f| f.test[k] && f.train[k]));
        }
        let by_recording = folds(&rows, Holdout::Recordings, 2, 4.0).unwrap();
        assert_eq!(by_recording[1].test.iter().filter(|t| **t).count(), 50);
        assert!(folds(&rows, Holdout::Recordings, 1, 0.0).is_err());
    }
}
