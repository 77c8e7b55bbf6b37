//! Which stretches of the recordings choose and fit the model, and which ones judge it.
//!
//! Recordings are cut before anything else is done to them, so that no filter reaches across a boundary.

use lacuna_interfaces::{BadInput, Recording};

/// How stretches are held out in turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Holdout {
    /// Every recording in turn.
    Recordings,
    /// Both halves of every recording's time, in turn.
    Halves,
    /// Every N-th of every recording's time, in turn.
    Kfold(usize),
}

/// A stretch of one recording by its index; the ends may be infinite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// Recording.
    pub recording: usize,
    /// Start, on the recording's clock [s].
    pub from_s: f64,
    /// End [s].
    pub to_s: f64,
}

/// How the recordings are divided.
///
/// With test stretches the model is chosen and fitted on the training stretches alone, and every held-out figure is of
/// the test stretches. Without them every fold is predicted by a fit to the others; the terms were then chosen with all
/// folds in view.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Split {
    /// What is held out in turn; `None`: whole recordings if there are five at least, otherwise parts of them.
    pub holdout: Option<Holdout>,
    /// What the model is chosen and fitted on; empty: all recordings.
    pub train: Vec<Span>,
    /// What it is judged on; empty: folds of the training stretches.
    pub test: Vec<Span>,
}

/// A stretch as findings and reports name it.
#[derive(Debug, Clone, PartialEq)]
pub struct Stretch {
    /// File name of the recording.
    pub recording: String,
    /// First sample [s].
    pub from_s: f64,
    /// Last sample [s].
    pub to_s: f64,
}

/// Recordings after the cut.
#[derive(Debug, Clone, Default)]
pub(crate) struct Set {
    /// The stretches, each a recording of its own under its file's name.
    pub recordings: Vec<Recording>,
    /// When each begins since the robot was switched on [s].
    pub start_s: Vec<f64>,
    /// Number of the fold of each, rising; empty: chosen by the conditioning.
    pub folds: Vec<usize>,
}

impl Set {
    /// What it consists of.
    pub fn stretches(&self) -> Vec<Stretch> {
        let end = |t: Option<&f64>| t.copied().unwrap_or(0.0);
        self.recordings
            .iter()
            .map(|r| Stretch { recording: r.name.clone(), from_s: end(r.t_s.first()), to_s: end(r.t_s.last()) })
            .collect()
    }
}

/// Fewest samples of a stretch.
const LEAST: usize = 64;

impl Split {
    /// Name as `identify` has it: `files`, `recordings`, `halves`, `kfold=N`, or `parts`.
    pub(crate) fn name(&self, recordings: usize) -> String {
        match self.holdout {
            _ if !self.test.is_empty() => "files".to_owned(),
            Some(Holdout::Recordings) => "recordings".to_owned(),
            Some(Holdout::Halves) => "halves".to_owned(),
            Some(Holdout::Kfold(n)) => format!("kfold={n}"),
            None if recordings >= crate::scene::MIN_FOLDS => "recordings".to_owned(),
            None => "parts".to_owned(),
        }
    }

    /// Cuts `recordings` into what trains and what tests (empty without test stretches). `start_s` tells when each
    /// began; where it is short, recordings follow one right after another.
    ///
    /// # Errors
    /// [`BadInput`] if a stretch is empty or too short, or training and test overlap.
    pub(crate) fn cut(&self, recordings: &[Recording], start_s: &[f64]) -> Result<(Set, Set), BadInput> {
        if recordings.is_empty() {
            return Err(BadInput::new("recordings: found none; expected one at least"));
        }
        let start = starts(recordings, start_s);
        if self.test.is_empty() && self.train.is_empty() {
            return Ok((self.folds(recordings, &start)?, Set::default()));
        }
        if self.test.is_empty() || self.train.is_empty() || self.holdout.is_some() {
            return Err(BadInput::new(
                "split: expected training and test stretches together, or a holdout, or neither",
            ));
        }
        for a in &self.train {
            for b in self.test.iter().filter(|b| b.recording == a.recording) {
                let (from, to) = (a.from_s.max(b.from_s), a.to_s.min(b.to_s));
                if from < to {
                    let name = recordings.get(a.recording).map_or("", |r| r.name.as_str());
                    return Err(BadInput::new(format!(
                        "found {} in training and test alike; expected stretches that do not overlap",
                        seconds(from, to)
                    ))
                    .in_file(name));
                }
            }
        }
        let all = |spans: &[Span]| -> Result<Set, BadInput> {
            let mut set = Set::default();
            for span in spans {
                let recording = recordings.get(span.recording).ok_or_else(|| {
                    BadInput::new(format!(
                        "found a stretch of recording {}; expected one below {}",
                        span.recording,
                        recordings.len()
                    ))
                })?;
                let begin = start.get(span.recording).copied().unwrap_or(0.0);
                set.push(recording, begin, span.from_s, span.to_s)?;
            }
            Ok(set)
        };
        Ok((all(&self.train)?, all(&self.test)?))
    }

    /// All recordings in the order of their folds.
    fn folds(&self, recordings: &[Recording], start: &[f64]) -> Result<Set, BadInput> {
        let mut set = Set::default();
        let parts = match self.holdout {
            None | Some(Holdout::Recordings) => 1,
            Some(Holdout::Halves) => 2,
            Some(Holdout::Kfold(n)) => n.max(2),
        };
        if self.holdout == Some(Holdout::Recordings) && recordings.len() < 2 {
            return Err(BadInput::new(format!(
                "holdout: found {} recording; expected at least 2 to hold one out (or use halves)",
                recordings.len()
            )));
        }
        if parts == 1 {
            set.recordings = recordings.to_vec();
            set.start_s = start.to_vec();
            if self.holdout.is_some() {
                set.folds = (0..recordings.len()).collect();
            }
            return Ok(set);
        }
        for part in 0..parts {
            for (recording, begin) in recordings.iter().zip(start) {
                let (first, width) =
                    (recording.t_s.first().copied().unwrap_or(0.0), recording.duration_s() / parts as f64);
                let from = if part == 0 { f64::NEG_INFINITY } else { first + part as f64 * width };
                let to = if part + 1 == parts { f64::INFINITY } else { first + (part + 1) as f64 * width };
                set.push(recording, *begin, from, to)?;
                set.folds.push(part);
            }
        }
        Ok(set)
    }
}

impl Set {
    /// Adds the samples of `recording` from `from_s` to below `to_s`.
    fn push(&mut self, recording: &Recording, begin_s: f64, from_s: f64, to_s: f64) -> Result<(), BadInput> {
        let a = recording.t_s.partition_point(|t| *t < from_s);
        let b = recording.t_s.partition_point(|t| *t < to_s).max(a);
        if b - a < LEAST {
            return Err(BadInput::new(format!(
                "found {} samples in {}; expected {LEAST} at least",
                b - a,
                seconds(from_s, to_s)
            ))
            .in_file(&recording.name));
        }
        let cut = |x: &Vec<f64>| x.get(a..b).unwrap_or_default().to_vec();
        let seen = self.recordings.iter().any(|r| r.name == recording.name);
        let first = recording.t_s.first().copied().unwrap_or(0.0);
        let t_s = cut(&recording.t_s);
        self.start_s.push(begin_s + t_s.first().copied().unwrap_or(first) - first);
        self.recordings.push(Recording {
            name: recording.name.clone(),
            joints: recording.joints.clone(),
            t_s,
            q_rad: recording.q_rad.iter().map(cut).collect(),
            tau_nm: recording.tau_nm.iter().map(cut).collect(),
            extra: recording.extra.iter().map(|(k, v)| (k.clone(), cut(v))).collect(),
            // What its reader repaired is told once.
            repairs: if seen { Vec::new() } else { recording.repairs.clone() },
        });
        Ok(())
    }
}

/// A stretch in words.
fn seconds(from_s: f64, to_s: f64) -> String {
    match (from_s.is_finite(), to_s.is_finite()) {
        (true, true) => format!("{from_s:.3} to {to_s:.3} s"),
        (true, false) => format!("all from {from_s:.3} s"),
        (false, true) => format!("all before {to_s:.3} s"),
        (false, false) => "all".to_owned(),
    }
}

/// When each recording began: as told, otherwise at the end of the one before.
fn starts(recordings: &[Recording], told: &[f64]) -> Vec<f64> {
    let mut clock = 0.0;
    recordings
        .iter()
        .enumerate()
        .map(|(i, r)| {
            let start = told.get(i).copied().unwrap_or(clock);
            clock = start + r.duration_s();
            start
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recording(name: &str, samples: usize) -> Recording {
        Recording {
            name: name.into(),
            joints: vec!["q1".into()],
            t_s: (0..samples).map(|k| 5.0 + 0.01 * k as f64).collect(),
            q_rad: vec![(0..samples).map(|k| k as f64).collect()],
            tau_nm: vec![vec![0.0; samples]],
            ..Recording::default()
        }
    }

    #[test]
    fn halves_are_every_recordings_halves_in_turn() {
        let all = [recording("a", 400), recording("b", 300)];
        let split = Split { holdout: Some(Holdout::Halves), ..Split::default() };
        let (set, test) = split.cut(&all, &[100.0, 200.0]).unwrap();
        assert!(test.recordings.is_empty());
        assert_eq!(set.folds, [0, 0, 1, 1]);
        let names: Vec<&str> = set.recordings.iter().map(|r| r.name.as_str()).collect();
        assert_eq!(names, ["a", "b", "a", "b"]);
        // Every sample once, and each half knows when it began.
        assert_eq!(set.recordings.iter().map(Recording::len).sum::<usize>(), 700);
        assert_eq!(set.recordings[2].q_rad[0][0], set.recordings[0].len() as f64);
        assert!((set.start_s[2] - (100.0 + 0.01 * set.recordings[0].len() as f64)).abs() < 1e-9);
        assert_eq!(set.start_s[..2], [100.0, 200.0]);
    }

    #[test]
    fn training_and_test_do_not_share_a_sample() {
        let all = [recording("a", 400)];
        let span = |from_s, to_s| Span { recording: 0, from_s, to_s };
        let split = |train, test| Split { train: vec![train], test: vec![test], ..Split::default() };
        let (train, test) = split(span(f64::NEG_INFINITY, 7.0), span(7.0, f64::INFINITY)).cut(&all, &[]).unwrap();
        assert_eq!((train.recordings[0].len(), test.recordings[0].len()), (200, 200));
        assert!((test.start_s[0] - 2.0).abs() < 1e-9);
        let e = split(span(5.0, 7.5), span(7.0, 8.0)).cut(&all, &[]).unwrap_err().to_string();
        assert!(e.contains("7.000 to 7.500 s") && e.starts_with("a:"), "{e}");
        let e = split(span(5.0, 6.0), span(60.0, 80.0)).cut(&all, &[]).unwrap_err().to_string();
        assert!(e.contains("found 0 samples"), "{e}");
        let one = Split { holdout: Some(Holdout::Recordings), ..Split::default() };
        assert!(one.cut(&all, &[]).unwrap_err().to_string().contains("found 1 recording"));
        let many = Split { holdout: Some(Holdout::Kfold(50)), ..Split::default() };
        assert!(many.cut(&all, &[]).unwrap_err().to_string().contains("expected 64"));
    }
}
