//! Text of unknown origin, made fit for a line: names of files, words of people.

use std::borrow::Cow;

/// True for what turns the direction of reading.
pub fn turns_reading(c: char) -> bool {
    matches!(c, '\u{200e}' | '\u{200f}' | '\u{061c}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// True for what would move the cursor, colour a terminal, begin a line or turn the direction of reading.
fn is_odd(c: char) -> bool {
    c.is_control() || turns_reading(c)
}

/// A text in which everything can be seen: characters that no line should have are escaped (`\n`, `\u{1b}`).
pub fn escaped(text: &str) -> Cow<'_, str> {
    if !text.contains(is_odd) {
        return Cow::Borrowed(text);
    }
    let mut out = String::new();
    for c in text.chars() {
        if is_odd(c) {
            out.extend(c.escape_default());
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

/// A text on one line: characters that no line should have are blanks.
pub fn one_line(text: &str) -> String {
    text.replace(is_odd, " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_line_should_have_is_seen_or_blank() {
        assert!(matches!(escaped("Città, 12 kN"), Cow::Borrowed("Città, 12 kN")));
        assert_eq!(
            escaped("x\n2026\u{1b}]0;t\u{7}\u{202e}"),
            "x\\n2026\\u{1b}]0;t\\u{7}\\u{202e}"
        );
        assert_eq!(one_line("Eve\nfake\u{1b}"), "Eve fake ");
    }
}
