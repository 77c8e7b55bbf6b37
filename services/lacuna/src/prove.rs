//! `lacuna prove`: is the diagnosis right? Findings against answers that it has not seen.

use crate::progress::Progress;
use crate::{CommandResult, words};
use clap::{Args, ValueEnum};
use lacuna_interfaces::BadInput;
use lacuna_prove::{Diagnosis, Error, Options, PARTS, Part, Section, Watcher, document};
use lacuna_stage::Failure;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

#[derive(Args)]
pub struct ProveArgs {
    /// What to prove.
    #[arg(value_enum)]
    part: PartArg,
    /// At most so many cases. Default: as many as the part is made for (concealed: 220).
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    cases: Option<u32>,
    /// Block of seeds: another number draws another proof. None of them is used for anything else.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Keep cases, findings and, afterwards, answers here. Must be empty or new.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Folder with the recordings that do not belong to the project; parts that need them say SKIPPED without.
    #[arg(long, value_name = "DIR", default_value = "../shared")]
    shared: PathBuf,
    /// A diagnosis counts as failed after this [s].
    #[arg(long, value_name = "SECONDS", default_value_t = 600.0, allow_negative_numbers = true)]
    limit: f64,
    /// Write all results as a Markdown document.
    #[arg(long, value_name = "FILE")]
    write: Option<PathBuf>,
    /// Print the results as JSON on standard output; hashes of sealed answers go to standard error.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum PartArg {
    /// Simulated robots with zero to three concealed effects, answers sealed.
    Concealed,
    /// Concealed cases of another engine.
    Engine,
    /// Effects planted into, or withheld from, real recordings.
    Planted,
    /// Real recordings as found.
    Real,
    /// The paper's story, from its nominal model alone.
    Paper,
    /// All of them.
    All,
}

impl PartArg {
    fn parts(self) -> &'static [Part] {
        match self {
            Self::Concealed => &[Part::Concealed],
            Self::Engine => &[Part::Engine],
            Self::Planted => &[Part::Planted],
            Self::Real => &[Part::Real],
            Self::Paper => &[Part::Paper],
            Self::All => &PARTS,
        }
    }
}

/// Progress on standard error; hashes where they are seen.
struct Screen {
    progress: Progress,
    part: &'static str,
    json: bool,
}

impl Watcher for Screen {
    fn at(&mut self, share: f64, words: &str) {
        self.progress.at(share, &format!("{}: {words}", self.part));
    }

    fn say(&mut self, line: &str) {
        self.progress.say(line, self.json);
    }
}

/// `lacuna prove`.
pub fn prove(args: &ProveArgs) -> CommandResult {
    if let Some(out) = &args.out {
        words::folder_for(out)?;
    }
    if let Some(path) = args.write.as_deref().filter(|p| p.is_dir()) {
        return Err(BadInput::new("found a folder; expected a file, or a name that is free").in_file(path).into());
    }
    let limit = Duration::try_from_secs_f64(words::positive("--limit", args.limit)?)
        .map_err(|_| BadInput::new(format!("--limit: found {}; expected a number of seconds", args.limit)))?;
    let program = std::env::current_exe().map_err(|e| Failure::run(format!("own executable: {e}")))?;
    let options = Options {
        diagnosis: Diagnosis { program, limit },
        cases: args.cases.map(|n| n as usize),
        seed: args.seed,
        out: args.out.clone(),
        shared: args.shared.clone(),
    };
    let mut sections: Vec<Section> = Vec::new();
    let mut failed = None;
    let parts = args.part.parts();
    for part in parts {
        let mut screen = Screen { progress: Progress::bar(), part: part.name(), json: args.json };
        let made = lacuna_prove::prove(*part, &options, &mut screen);
        drop(screen);
        let section = match made {
            Ok(section) => section,
            Err(e) if parts.len() == 1 => return Err(failure(e)),
            // The other parts, half an hour of work, are not lost with this one.
            Err(e) => {
                let why = format!("this part could not be made: {e}");
                failed.get_or_insert(failure(e));
                Section::skipped(*part, part.name(), &options, why)
            }
        };
        if !args.json {
            words::say(&format!("\n{}", section.text()))?;
        }
        sections.push(section);
        if let Some(path) = &args.write {
            write(path, &sections)?;
        }
    }
    if args.json {
        words::print_json(&sections)?;
    }
    failed.map_or(Ok(ExitCode::SUCCESS), Err)
}

fn write(path: &Path, sections: &[Section]) -> Result<(), Failure> {
    words::write(path, document::markdown(sections, env!("CARGO_PKG_VERSION")).as_bytes())
}

fn failure(e: Error) -> Failure {
    match e {
        Error::Input(e) => e.into(),
        Error::Run(what) => Failure::run(what),
    }
}
