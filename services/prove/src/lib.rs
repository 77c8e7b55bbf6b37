//! `lacuna prove`: is a diagnosis right? Findings are held against answers that the diagnosis has not seen.
//!
//! | part | answers from |
//! |---|---|
//! | [`concealed`] | the project's simulator: robots, motions, noise and zero to three effects drawn from seeds that nothing else uses |
//! | [`engine`] | another engine's recordings with keys |
//! | [`planted`] | real recordings with an effect added to the torque, or with a known one withheld from the model |
//! | [`real`] | real recordings as they are, with what their makers and independent fits say of them |
//! | [`paper`] | the paper's story: inertia, friction and payload from the nominal model alone |
//!
//! The diagnosis runs as a process of its own ([`diagnosis`]) and is judged by the files it writes ([`said`]); this
//! crate does not depend on it. Scores are in [`score`], seeds in [`seeds`], sealed answers in [`seal`].

pub mod concealed;
pub mod diagnosis;
pub mod document;
pub mod engine;
pub mod error;
pub mod hidden;
pub mod paper;
pub mod planted;
pub mod real;
pub mod said;
pub mod score;
pub mod seal;
pub mod section;
pub mod seeds;
mod workplace;

pub use diagnosis::Diagnosis;
pub use error::Error;
pub use section::Section;
pub use workplace::Workplace;

use std::path::PathBuf;

/// What a user may choose.
#[derive(Debug, Clone)]
pub struct Options {
    /// The diagnosis.
    pub diagnosis: Diagnosis,
    /// At most so many cases; `None`: as many as the part is made for.
    pub cases: Option<usize>,
    /// Block of seeds, see [`seeds`].
    pub seed: u64,
    /// Where cases, findings and (afterwards) answers are kept; `None`: nowhere.
    pub out: Option<PathBuf>,
    /// Folder with `data/`, recordings that do not belong to the project.
    pub shared: PathBuf,
}

impl Options {
    /// The command that makes a part again.
    pub fn command(&self, part: Part) -> String {
        let mut command = format!("lacuna prove {}", part.name());
        if let Some(cases) = self.cases {
            command += &format!(" --cases {cases}");
        }
        if self.seed != 0 {
            command += &format!(" --seed {}", self.seed);
        }
        command
    }
}

/// A part of the proof.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Simulated robots with concealed effects.
    Concealed,
    /// Another engine's recordings.
    Engine,
    /// Effects planted into, or withheld from, real recordings.
    Planted,
    /// Real recordings as they are.
    Real,
    /// The paper's story.
    Paper,
}

/// Every part, in the order of the document.
pub const PARTS: [Part; 5] = [Part::Concealed, Part::Engine, Part::Planted, Part::Real, Part::Paper];

impl Part {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Concealed => "concealed",
            Self::Engine => "engine",
            Self::Planted => "planted",
            Self::Real => "real",
            Self::Paper => "paper",
        }
    }
}

/// Whoever watches a proof.
pub trait Watcher {
    /// The share done, 0 to 1, and what is being done.
    fn at(&mut self, share: f64, words: &str);
    /// A line that must be seen now: the hashes of sealed answers.
    fn say(&mut self, line: &str);
}

/// Makes one part of the proof.
///
/// # Errors
/// [`Error`] if the proof itself cannot be made. Whatever the diagnosis gets wrong is in the result.
pub fn prove(part: Part, options: &Options, watcher: &mut dyn Watcher) -> Result<Section, Error> {
    if options.seed > seeds::MOST {
        let what = format!("--seed: found {}; expected at most {}", options.seed, seeds::MOST);
        return Err(lacuna_interfaces::BadInput::new(what).into());
    }
    match part {
        Part::Concealed => concealed::prove(options, watcher),
        Part::Engine => engine::prove(options, watcher),
        Part::Planted => planted::prove(options, watcher),
        Part::Real => real::prove(options, watcher),
        Part::Paper => paper::prove(options, watcher),
    }
}
