//! The one error every reader of user input returns: where, what was found, what was expected.

use std::fmt::{self, Write as _};
use std::path::{Path, PathBuf};

/// Input that cannot be used. Displays as one line, `FILE:LINE: found …; expected …`, and makes a command
/// exit with code 2.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadInput {
    /// File the input came from, if it came from a file.
    pub file: Option<PathBuf>,
    /// 1-based line in that file, if the input has lines.
    pub line: Option<u64>,
    /// What was found and what was expected, in words.
    pub what: String,
}

impl BadInput {
    /// Bad input with no file attached yet.
    pub fn new(what: impl Into<String>) -> Self {
        Self { file: None, line: None, what: what.into() }
    }

    /// The same error, said of `file` (kept if a file is already named: the innermost place is the useful one).
    #[must_use]
    pub fn in_file(mut self, file: impl AsRef<Path>) -> Self {
        self.file.get_or_insert_with(|| file.as_ref().to_path_buf());
        self
    }

    /// The same error, said of a 1-based `line`.
    #[must_use]
    pub fn at_line(mut self, line: u64) -> Self {
        self.line.get_or_insert(line);
        self
    }

    /// A TOML error with the line it points at. `text` is the document that was parsed.
    pub fn from_toml(error: &toml::de::Error, text: &str) -> Self {
        let line = error.span().map(|span| {
            let end = span.start.min(text.len());
            text.as_bytes()[..end].iter().filter(|&&b| b == b'\n').count() as u64 + 1
        });
        // toml's messages may span lines; an error here is one line.
        let what = error.message().split_whitespace().collect::<Vec<_>>().join(" ");
        Self { file: None, line, what }
    }
}

/// What input is quoted may hold line ends and terminal controls: they are shown, not obeyed.
struct OneLine<'a, 'f>(&'a mut fmt::Formatter<'f>);

impl fmt::Write for OneLine<'_, '_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for part in text.split_inclusive(char::is_control) {
            match part.chars().next_back().filter(|c| c.is_control()) {
                Some(control) => {
                    self.0.write_str(part.strip_suffix(control).unwrap_or(part))?;
                    write!(self.0, "{}", control.escape_default())?;
                }
                None => self.0.write_str(part)?,
            }
        }
        Ok(())
    }
}

impl fmt::Display for BadInput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut f = OneLine(f);
        match (&self.file, self.line) {
            (Some(file), Some(line)) => write!(f, "{}:{line}: {}", file.display(), self.what),
            (Some(file), None) => write!(f, "{}: {}", file.display(), self.what),
            (None, Some(line)) => write!(f, "line {line}: {}", self.what),
            (None, None) => f.write_str(&self.what),
        }
    }
}

impl std::error::Error for BadInput {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_is_quoted_stays_on_one_line() {
        let error = BadInput::new("found \"a\nb\r\u{1b}[2Jc\u{85}\"; expected ä").in_file("x\ny.toml").at_line(3);
        assert_eq!(error.to_string(), "x\\ny.toml:3: found \"a\\nb\\r\\u{1b}[2Jc\\u{85}\"; expected ä");
    }
}
