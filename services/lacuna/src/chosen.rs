//! Which recordings a command reads, and which parts of them train and test.

use lacuna_diagnose::{Holdout, Span, Split};
use lacuna_identify::FileRange;
use lacuna_interfaces::BadInput;
use std::path::{Path, PathBuf};

/// Files, each once, and how they are divided.
#[derive(Debug)]
pub struct Chosen {
    /// The files in the order in which they are named first.
    pub paths: Vec<PathBuf>,
    /// Stretches by the index of their file.
    pub split: Split,
}

impl Chosen {
    /// From the arguments of a command: recordings (with a holdout, or not), or training and test stretches.
    ///
    /// # Errors
    /// [`BadInput`] if the arguments contradict one another.
    pub fn of(
        recordings: &[PathBuf],
        train: &[String],
        test: &[String],
        holdout: Option<&str>,
    ) -> Result<Self, BadInput> {
        let parse = |list: &[String]| list.iter().map(|t| t.parse()).collect::<Result<Vec<FileRange>, BadInput>>();
        let (train, test) = (parse(train)?, parse(test)?);
        let explicit = !(train.is_empty() && test.is_empty());
        if explicit && (train.is_empty() || test.is_empty()) {
            return Err(BadInput::new(format!(
                "found {} training and {} test recordings; expected both, or recordings alone to hold out in turn",
                train.len(),
                test.len()
            )));
        }
        if explicit && (!recordings.is_empty() || holdout.is_some()) {
            return Err(BadInput::new(
                "found recordings or a holdout together with --train and --test; expected one way of splitting",
            ));
        }
        let mut paths: Vec<PathBuf> = Vec::new();
        recordings.iter().for_each(|p| {
            index(&mut paths, p);
        });
        if !explicit && paths.is_empty() {
            return Err(BadInput::new("found no recording; expected at least one"));
        }
        let mut spans = |list: &[FileRange]| -> Vec<Span> {
            list.iter()
                .map(|r| Span {
                    recording: index(&mut paths, &r.file),
                    from_s: r.from_s.unwrap_or(f64::NEG_INFINITY),
                    to_s: r.to_s.unwrap_or(f64::INFINITY),
                })
                .collect()
        };
        let (train, test) = (spans(&train), spans(&test));
        Ok(Self { paths, split: Split { holdout: holdout.map(parse_holdout).transpose()?, train, test } })
    }
}

/// Place of `path` among `paths`, at the end if it is new.
fn index(paths: &mut Vec<PathBuf>, path: &Path) -> usize {
    paths.iter().position(|p| p == path).unwrap_or_else(|| {
        paths.push(path.to_path_buf());
        paths.len() - 1
    })
}

fn parse_holdout(text: &str) -> Result<Holdout, BadInput> {
    Ok(match text.parse::<lacuna_identify::Holdout>()? {
        lacuna_identify::Holdout::Recordings => Holdout::Recordings,
        lacuna_identify::Holdout::Halves => Holdout::Halves,
        lacuna_identify::Holdout::Kfold(n) => Holdout::Kfold(n),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_read_once_and_ways_of_splitting_do_not_mix() {
        let text = |list: &[&str]| list.iter().map(|s| (*s).to_owned()).collect::<Vec<String>>();
        let chosen = Chosen::of(&[], &text(&["a.csv@:5"]), &text(&["a.csv@5:", "b.csv"]), None).unwrap();
        assert_eq!(chosen.paths, [PathBuf::from("a.csv"), PathBuf::from("b.csv")]);
        assert_eq!(chosen.split.train, [Span { recording: 0, from_s: f64::NEG_INFINITY, to_s: 5.0 }]);
        assert_eq!(chosen.split.test.iter().map(|s| s.recording).collect::<Vec<_>>(), [0, 1]);
        let files = [PathBuf::from("a.csv")];
        assert_eq!(Chosen::of(&files, &[], &[], Some("kfold=3")).unwrap().split.holdout, Some(Holdout::Kfold(3)));
        for bad in [
            Chosen::of(&[], &[], &[], None),
            Chosen::of(&[], &text(&["a.csv"]), &[], None),
            Chosen::of(&files, &text(&["a.csv"]), &text(&["b.csv"]), None),
            Chosen::of(&[], &text(&["a.csv"]), &text(&["b.csv"]), Some("halves")),
            Chosen::of(&files, &[], &[], Some("third")),
        ] {
            let e = bad.unwrap_err().to_string();
            assert!(e.contains("expected") && !e.contains('\n'), "{e}");
        }
    }
}
