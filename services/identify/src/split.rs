//! Which rows train and which test.

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

/// Time that trains and time that tests.
#[derive(Debug, Clone, PartialEq)]
pub struct Fold {
    /// Training spans.
    pub train: Vec<Span>,
    /// Test spans.
    pub test: Vec<Span>,
}

/// A range of one recording by its index; both ends belong to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Span {
    /// Recording.
    pub recording: usize,
    /// Start [s].
    pub from_s: f64,
    /// End [s].
    pub to_s: f64,
}

impl Span {
    /// All of a recording.
    pub fn whole(recording: usize) -> Self {
        Self { recording, from_s: f64::NEG_INFINITY, to_s: f64::INFINITY }
    }

    /// Whether the time `t_s` of a recording lies in it.
    pub fn holds(&self, recording: usize, t_s: f64) -> bool {
        self.recording == recording && self.from_s <= t_s && t_s <= self.to_s
    }
}

/// The folds of a holdout. `extent` holds the times of the first and the last row of every recording. `gap_s` around a
/// boundary within a recording belongs to neither side: there the filter mixes both.
///
/// # Errors
/// [`BadInput`] if there are fewer recordings than folds need.
pub fn folds(extent: &[(f64, f64)], holdout: Holdout, gap_s: f64) -> Result<Vec<Fold>, BadInput> {
    let recordings = extent.len();
    let parts = match holdout {
        Holdout::Recordings => {
            if recordings < 2 {
                return Err(BadInput::new(format!(
                    "holdout: found {recordings} recording; expected at least 2 to hold one out (or use halves)"
                )));
            }
            let others = |r: usize| (0..recordings).filter(move |o| *o != r).map(Span::whole).collect();
            return Ok((0..recordings).map(|r| Fold { train: others(r), test: vec![Span::whole(r)] }).collect());
        }
        Holdout::Halves => 2,
        Holdout::Kfold(n) => n.max(2),
    };
    Ok((0..parts)
        .map(|part| {
            let mut fold = Fold { train: Vec::new(), test: Vec::new() };
            for (recording, &(from, to)) in extent.iter().enumerate() {
                let width = (to - from) / parts as f64;
                let (low, high) = (from + part as f64 * width, from + (part + 1) as f64 * width);
                // The very ends have no neighbour to keep away from.
                let (first, last) = (part == 0, part + 1 == parts);
                let from_s = if first { f64::NEG_INFINITY } else { low + 0.5 * gap_s };
                let to_s = if last { f64::INFINITY } else { high - 0.5 * gap_s };
                fold.test.push(Span { recording, from_s, to_s });
                if !first {
                    let to_s = (low - 0.5 * gap_s).next_down();
                    fold.train.push(Span { recording, from_s: f64::NEG_INFINITY, to_s });
                }
                if !last {
                    let from_s = (high + 0.5 * gap_s).next_up();
                    fold.train.push(Span { recording, from_s, to_s: f64::INFINITY });
                }
            }
            fold
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
        let extent = [(0.0, 49.0), (0.0, 49.0)];
        let holds = |spans: &[Span], r: usize, t: f64| spans.iter().any(|s| s.holds(r, t));
        let halves = folds(&extent, Holdout::Halves, 4.0).unwrap();
        let thirds = folds(&extent, Holdout::Kfold(3), 4.0).unwrap();
        assert_eq!((halves.len(), thirds.len()), (2, 3));
        for (r, t) in (0..100).map(|k| (k / 50, f64::from(k as u32 % 50))) {
            let tested: usize = halves.iter().map(|f| usize::from(holds(&f.test, r, t))).sum();
            assert_eq!(tested, usize::from((t - 24.5).abs() >= 2.0), "{r} {t}");
            for f in halves.iter().chain(&thirds) {
                let (train, test) = (holds(&f.train, r, t), holds(&f.test, r, t));
                assert!(!(train && test));
                // What is on neither side is within half a gap of a boundary.
                let near = [24.5, 49.0 / 3.0, 98.0 / 3.0].iter().any(|b| (t - b).abs() <= 2.0);
                assert!(train || test || near, "{r} {t}");
            }
        }
        let by_recording = folds(&extent, Holdout::Recordings, 4.0).unwrap();
        assert_eq!(by_recording[1], Fold { train: vec![Span::whole(0)], test: vec![Span::whole(1)] });
        assert!(folds(&extent[..1], Holdout::Recordings, 0.0).is_err());
    }
}
