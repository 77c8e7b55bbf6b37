//! Command lines, and what is said of one that cannot be used: a line, like every other error.

use crate::process::Failure;
use clap::error::{ContextKind, ErrorKind};
use clap::{ArgMatches, Command};
use lacuna_interfaces::BadInput;

/// What the user asked `command` for. Help and version are printed, and the process ends.
///
/// # Errors
/// [`Failure::Usage`] in one line: the command, what was found, what would be right, where the help is.
pub fn matches(command: Command) -> Result<ArgMatches, Failure> {
    command.try_get_matches().map_err(|e| match e.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            e.exit()
        }
        _ => failure(&e),
    })
}

/// An error of the command line in one line.
pub fn failure(error: &clap::Error) -> Failure {
    let usage = error.get(ContextKind::Usage).map(ToString::to_string).unwrap_or_default();
    let what = folded(&error.render().to_string());
    BadInput::new(match command(&usage) {
        Some(command) => format!("{command}: {what}; see '{command} --help'"),
        None => what,
    })
    .into()
}

/// `lacuna bench graph` of `Usage: lacuna bench graph [OPTIONS]`.
fn command(usage: &str) -> Option<String> {
    let words = usage.strip_prefix("Usage:")?.split_whitespace();
    let names: Vec<&str> = words.take_while(|w| !w.starts_with(['[', '<', '-', '{'])).collect();
    (!names.is_empty()).then(|| names.join(" "))
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
        let found = tool().try_get_matches_from(words).unwrap_err();
        failure(&found).to_string()
    }

    #[test]
    fn every_mistake_is_one_line_that_names_the_command_and_what_is_right() {
        let see = "; see 'tool run --help'";
        for (words, line) in [
            (
                &["tool", "run", "--sped", "3"][..],
                "tool run: unexpected argument '--sped' found; a similar argument exists: '--speed'",
            ),
            (
                &["tool", "run"],
                "tool run: the following required arguments were not provided: --speed <speed>, --out <FILE>",
            ),
            (
                &["tool", "run", "--speed", "fast", "--out", "x"],
                "tool run: invalid value 'fast' for '--speed <speed>': invalid float literal",
            ),
            (
                &["tool", "run", "--speed", "1", "--out", "x", "--kind", "quik"],
                "tool run: invalid value 'quik' for '--kind <kind>' [possible values: slow, quick]; a similar value exists: 'quick'",
            ),
            (&["tool", "rum"], "tool: unrecognized subcommand 'rum'; a similar subcommand exists: 'run'"),
        ] {
            let said = said(words);
            assert!(said.starts_with(line) && said.contains("; see 'tool"), "{said}");
            if words.get(1) == Some(&"run") {
                assert!(said.ends_with(see), "{said}");
            }
        }
    }

    #[test]
    fn what_is_quoted_is_shown_and_not_obeyed() {
        let said = said(&["tool", "run", "--speed", "1\n\u{1b}[2J", "--out", "x"]);
        assert!(!said.contains(char::is_control) && said.contains("see 'tool run --help'"), "{said}");
    }
}
