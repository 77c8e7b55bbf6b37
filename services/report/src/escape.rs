//! Escaping: nothing a file, a joint or a recording is called can become markup or script.
//!
//! Joint and file names are somebody else's input. They reach a report in three places, and each has
//! one function here: HTML text and attributes ([`text`]), HTML with mathematical notation ([`math`]),
//! and the JSON block the charts are read from ([`json`]).

/// Escapes a string for HTML text, for double- or single-quoted attributes, and for XML.
///
/// Control characters and the bidirectional overrides, which could make a name read as another one, are
/// shown as U+FFFD.
#[must_use]
pub fn text(raw: &str) -> String {
    let mut out = String::with_capacity(raw.len() + 16);
    for c in raw.chars() {
        push(&mut out, c);
    }
    out
}

fn push(out: &mut String, c: char) {
    match c {
        '&' => out.push_str("&amp;"),
        '<' => out.push_str("&lt;"),
        '>' => out.push_str("&gt;"),
        '"' => out.push_str("&quot;"),
        '\'' => out.push_str("&#39;"),
        '\n' | '\t' => out.push(c),
        '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{fffe}' | '\u{ffff}' => out.push('\u{fffd}'),
        c if c.is_control() => out.push('\u{fffd}'),
        c => out.push(c),
    }
}

/// Escapes a formula or symbol in plain notation, with `_x` and `^x` set as sub- and superscripts.
///
/// The script runs over the letters and digits that follow, or over a `{…}` group, which may hold further
/// scripts: `f_v`, `v_s^2`, `m_{p,1}`, `e^{−(θ/v_s)^2}`. Everything else is taken as it stands.
#[must_use]
pub fn math(raw: &str) -> String {
    math_at(raw, 0)
}

/// Groups nested deeper than this are written as text, so that no input can exhaust the stack.
const DEEPEST: usize = 4;

fn math_at(raw: &str, depth: usize) -> String {
    let mut out = String::with_capacity(raw.len() + 32);
    let mut chars = raw.chars().peekable();
    while let Some(c) = chars.next() {
        // Many fonts set a combining dot into the letter: a time derivative must not look like its variable.
        let dots = match chars.peek() {
            Some('\u{307}') => "·",
            Some('\u{308}') => "··",
            _ => "",
        };
        if !dots.is_empty() {
            let mark = chars.next();
            let mut letter = String::new();
            push(&mut letter, c);
            let name: String = letter.chars().chain(mark).collect();
            out.push_str(&format!("<span class=\"dot\" data-dots=\"{dots}\" aria-label=\"{name}\">{letter}</span>"));
            continue;
        }
        let tag = match c {
            '_' => "sub",
            '^' => "sup",
            _ => {
                push(&mut out, c);
                continue;
            }
        };
        let script = if chars.next_if_eq(&'{').is_some() {
            let inner = group(&mut chars);
            if depth < DEEPEST { math_at(&inner, depth + 1) } else { text(&inner) }
        } else {
            let mut plain = String::new();
            while let Some(inner) = chars.next_if(|n| n.is_alphanumeric() || matches!(n, '⁺' | '⁻')) {
                push(&mut plain, inner);
            }
            plain
        };
        if script.is_empty() {
            push(&mut out, c);
        } else {
            out.push_str(&format!("<{tag}>{script}</{tag}>"));
        }
    }
    out
}

/// What stands between a `{` already read and the `}` that closes it (or the end).
fn group(chars: &mut std::iter::Peekable<std::str::Chars<'_>>) -> String {
    let (mut inner, mut open) = (String::new(), 1_usize);
    for c in chars.by_ref() {
        match c {
            '{' => open += 1,
            '}' => open -= 1,
            _ => {}
        }
        if open == 0 {
            break;
        }
        inner.push(c);
    }
    inner
}

/// Makes serialized JSON safe inside a `<script>` element: no character of it can close the element,
/// open a comment or end a line of script. The JSON means the same afterwards.
#[must_use]
pub fn json(serialized: &str) -> String {
    let mut out = String::with_capacity(serialized.len() + 16);
    for c in serialized.chars() {
        match c {
            '<' => out.push_str("\\u003c"),
            '>' => out.push_str("\\u003e"),
            '&' => out.push_str("\\u0026"),
            '\u{2028}' => out.push_str("\\u2028"),
            '\u{2029}' => out.push_str("\\u2029"),
            c => out.push(c),
        }
    }
    out
}

/// The name as it is written in a report: at most `limit` characters, the cut marked by an ellipsis.
#[must_use]
pub fn shortened(raw: &str, limit: usize) -> String {
    match raw.char_indices().nth(limit) {
        None => raw.to_owned(),
        Some((byte, _)) => format!("{}…", raw.get(..byte).unwrap_or_default()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_in_names_is_text() {
        assert_eq!(text("</script><b>\"'&"), "&lt;/script&gt;&lt;b&gt;&quot;&#39;&amp;");
        assert_eq!(text("a\u{0}b\u{202e}c"), "a\u{fffd}b\u{fffd}c");
    }

    #[test]
    fn json_survives_a_script_element_and_reads_back() {
        let raw = "</script><!--\u{2028}&";
        let safe = json(&serde_json::to_string(raw).expect("a string serializes"));
        assert!(!safe.contains(['<', '>', '&', '\u{2028}']));
        assert_eq!(serde_json::from_str::<String>(&safe).expect("still JSON"), raw);
    }

    #[test]
    fn scripts_are_set_and_still_escaped() {
        assert_eq!(math("f_v q"), "f<sub>v</sub> q");
        assert_eq!(math("\"\u{307}"), "<span class=\"dot\" data-dots=\"·\" aria-label=\"&quot;\u{307}\">&quot;</span>");
        assert_eq!(math("e^{-(x/v_s)}"), "e<sup>-(x/v<sub>s</sub>)</sup>");
        assert_eq!(math("a_<b"), "a_&lt;b");
        assert_eq!(math("_{<script>}"), "<sub>&lt;script&gt;</sub>");
        assert_eq!(math("x_{unclosed"), "x<sub>unclosed</sub>");
        assert_eq!(math("e^{x_{1}^2}+1"), "e<sup>x<sub>1</sub><sup>2</sup></sup>+1");
        let deep = "_{".repeat(100_000);
        assert!(math(&deep).len() < 10 * deep.len());
    }

    #[test]
    fn shortening_counts_characters_not_bytes() {
        assert_eq!(shortened("θθθ", 2), "θθ…");
        assert_eq!(shortened("θθ", 2), "θθ");
    }
}
