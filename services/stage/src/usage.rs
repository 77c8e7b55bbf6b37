//! Command lines, and what is said of one that cannot be used: a line, like every other error.

use crate::process::Failure;
use clap::error::ErrorKind;
use clap::{Command, Error, FromArgMatches};
use lacuna_interfaces::BadInput;
use std::ffi::OsString;
use std::path::Path;

/// What the user asked `command` for. Help and version are printed, and the process ends.
///
/// # Errors
/// [`Failure::Usage`] in one line: the command, what was found, what would be right, where the help is.
pub fn parse<T: FromArgMatches>(mut command: Command) -> Result<T, Failure> {
    let words: Vec<OsString> = std::env::args_os().collect();
    parse_from(&mut command, &words).map_err(|e| match e.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            e.exit()
        }
        _ => failure(&e, &named(&command, &words)),
    })
}

fn parse_from<T: FromArgMatches>(command: &mut Command, words: &[OsString]) -> Result<T, Error> {
    let found = command.try_get_matches_from_mut(words)?;
    T::from_arg_matches(&found)
}

/// `lacuna bench graph`, as far as the words name a command.
fn named(command: &Command, words: &[OsString]) -> String {
    let own = words.first().and_then(|w| Path::new(w).file_name()).map(|n| n.to_string_lossy().into_owned());
    let mut names = vec![own.unwrap_or_else(|| command.get_name().to_owned())];
    let mut at = command;
    for word in words.iter().skip(1).filter(|w| !w.to_string_lossy().starts_with('-')) {
        let Some(sub) = at.find_subcommand(word) else { break };
        names.push(sub.get_name().to_owned());
        at = sub;
    }
    names.join(" ")
}

fn failure(error: &Error, command: &str) -> Failure {
    BadInput::new(format!("{command}: {}; see '{command} --help'", folded(&error.render().to_string()))).into()
}

/// The message and its tips, without the usage below them.
fn folded(rendered: &str) -> String {
    let text = rendered.strip_prefix("error: ").unwrap_or(rendered);
    let end = ["\n\nUsage:", "\n\nFor more information"].iter().filter_map(|mark| text.find(mark)).min();
    let paragraphs = text.get(..end.unwrap_or(text.len())).unwrap_or(text).split("\n\n");
    // A list of arguments, or of values, stands in lines of its own.
    let line = |paragraph: &str| {
        let mut lines = paragraph.lines().map(str::trim).filter(|l| !l.is_empty());
        let head = lines.next().unwrap_or_default().to_owned();
        let rest: Vec<&str> = lines.collect();
        if rest.is_empty() { head } else { format!("{head} {}", rest.join(", ")) }
    };
    paragraphs.map(line).filter(|l| !l.is_empty()).map(|l| l.replace("tip: ", "")).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Arg, value_parser};

    fn tool() -> Command {
        let speed = Arg::new("speed").long("speed").required(true).value_parser(value_parser!(f64));
        let out = Arg::new("out").long("out").value_name("FILE").required(true);
        let kind = Arg::new("kind").long("kind").value_parser(["slow", "quick"]);
        Command::new("tool").subcommand(Command::new("run").arg(speed).arg(out).arg(kind))
    }

    fn said(words: &[&str]) -> String {
        let words: Vec<OsString> = ["/usr/bin/tool"].iter().chain(words).map(OsString::from).collect();
        let mut command = tool();
        let error = parse_from::<()>(&mut command, &words).unwrap_err();
        failure(&error, &named(&command, &words)).to_string()
    }

    #[test]
    fn every_mistake_is_one_line_that_names_the_command_and_what_is_right() {
        for (words, line) in [
            (
                &["run", "--sped", "3"][..],
                "tool run: unexpected argument '--sped' found; a similar argument exists: '--speed'; see 'tool run --help'",
            ),
            (
                &["run"],
                "tool run: the following required arguments were not provided: --speed <speed>, --out <FILE>; see 'tool run --help'",
            ),
            (
                &["run", "--speed", "fast", "--out", "x"],
                "tool run: invalid value 'fast' for '--speed <speed>': invalid float literal; see 'tool run --help'",
            ),
            (
                &["run", "--speed", "1", "--out", "x", "--kind", "quik"],
                "tool run: invalid value 'quik' for '--kind <kind>' [possible values: slow, quick]; a similar value exists: \
                 'quick'; see 'tool run --help'",
            ),
            (&["runn"], "tool: unrecognized subcommand 'runn'; a similar subcommand exists: 'run'; see 'tool --help'"),
        ] {
            assert_eq!(said(words), line);
        }
    }

    #[test]
    fn what_is_quoted_is_shown_and_not_obeyed() {
        let said = said(&["run", "--speed", "1\n\u{1b}[2J", "--out", "x"]);
        assert!(!said.contains(char::is_control) && said.contains("see 'tool run --help'"), "{said}");
    }
}
