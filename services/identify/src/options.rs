//! What a user may choose about an identification.

use crate::columns::Signal;
use crate::condition::Conditioning;
use crate::delay::Delay;
use crate::fit::Instruments;
use crate::split::{FileRange, Holdout, Span};
use lacuna_interfaces::BadInput;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Which estimator makes the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// All base parameters and friction of all joints in one weighted, robust fit.
    #[default]
    Pooled,
    /// The paper's grid search and averages (Delta only).
    Paper,
}

impl std::str::FromStr for Method {
    type Err = BadInput;

    fn from_str(text: &str) -> Result<Self, BadInput> {
        match text {
            "pooled" => Ok(Self::Pooled),
            "paper" => Ok(Self::Paper),
            _ => Err(BadInput::new(format!("method: found \"{text}\"; expected pooled or paper"))),
        }
    }
}

/// What a user may choose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Robot file.
    pub robot: PathBuf,
    /// Recordings to train on and to hold out in turn; not together with `train` and `test`.
    pub recordings: Vec<PathBuf>,
    /// Recordings, or parts of them, to train on.
    pub train: Vec<FileRange>,
    /// Recordings, or parts of them, to test on.
    pub test: Vec<FileRange>,
    /// How to hold out. Default: by recording; by halves of time for a single one.
    pub holdout: Option<Holdout>,
    /// Estimator.
    pub method: Method,
    /// Which torque is modelled.
    pub signal: Signal,
    /// Bound the influence of outliers.
    pub robust: bool,
    /// Fit with positive definite pseudo-inertias and positive friction; the cost in fit is accounted for.
    pub consistent: bool,
    /// Delay between torque and position.
    pub delay: Delay,
    /// Instruments against encoder noise in the accelerations.
    pub instruments: Instruments,
    /// Filters and masks.
    pub conditioning: Conditioning,
    /// Length of a block of time behind the intervals [s]. Default: a hundredth of the data, from eight periods of the
    /// band to 2 s.
    pub block_s: Option<f64>,
    /// Memory for rows that are looked at again [bytes], about twice of which is taken; what does not fit is computed anew.
    pub row_memory: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            robot: PathBuf::new(),
            recordings: Vec::new(),
            train: Vec::new(),
            test: Vec::new(),
            holdout: None,
            method: Method::Pooled,
            signal: Signal::Motor,
            robust: true,
            consistent: false,
            delay: Delay::Estimate,
            instruments: Instruments::Auto,
            conditioning: Conditioning::default(),
            block_s: None,
            row_memory: 64 << 20,
        }
    }
}

/// The distinct files of the options and the ranges in them.
pub(crate) struct Files {
    pub(crate) paths: Vec<PathBuf>,
    train: Vec<(usize, FileRange)>,
    test: Vec<(usize, FileRange)>,
}

impl Files {
    pub(crate) fn of(options: &Options) -> Result<Self, BadInput> {
        let explicit = !(options.train.is_empty() && options.test.is_empty());
        if explicit && (options.train.is_empty() || options.test.is_empty()) {
            return Err(BadInput::new(format!(
                "found {} training and {} test recordings; expected both, or recordings alone to hold out in turn",
                options.train.len(),
                options.test.len()
            )));
        }
        if explicit && (!options.recordings.is_empty() || options.holdout.is_some()) {
            return Err(BadInput::new(
                "found recordings or a holdout together with train and test; expected one way of splitting",
            ));
        }
        if !explicit && options.recordings.is_empty() {
            return Err(BadInput::new("found no recording; expected at least one"));
        }
        let mut paths: Vec<PathBuf> = Vec::new();
        let mut index = |path: &PathBuf| {
            paths.iter().position(|p| p == path).unwrap_or_else(|| {
                paths.push(path.clone());
                paths.len() - 1
            })
        };
        options.recordings.iter().for_each(|p| {
            index(p);
        });
        let mut of = |list: &[FileRange]| list.iter().map(|r| (index(&r.file), r.clone())).collect();
        let (train, test) = (of(&options.train), of(&options.test));
        Ok(Self { paths, train, test })
    }

    pub(crate) fn spans(&self) -> (Vec<Span>, Vec<Span>) {
        let of = |list: &[(usize, FileRange)]| {
            list.iter()
                .map(|(recording, r)| Span {
                    recording: *recording,
                    from_s: r.from_s.unwrap_or(f64::NEG_INFINITY),
                    to_s: r.to_s.unwrap_or(f64::INFINITY),
                })
                .collect()
        };
        (of(&self.train), of(&self.test))
    }
}
