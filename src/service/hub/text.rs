//! Text of unknown origin, made fit for a database, a log and a page.

/// A text in one line of at most `most` bytes: what no database or log takes is escaped, what is too long is cut.
pub fn fit(text: &str, most: usize) -> String {
    const CUT: &str = "…";
    let mut out = String::new();
    for c in text.chars() {
        let turns = matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
        let piece = if c.is_control() || turns {
            c.escape_unicode().to_string()
        } else {
            c.to_string()
        };
        if out.len() + piece.len() > most {
            while out.len() + CUT.len() > most && out.pop().is_some() {}
            out += CUT;
            break;
        }
        out += &piece;
    }
    out
}

/// A text as the value of a metric's label.
pub fn label(text: &str) -> String {
    text.replace('\\', "\\\\")
        .replace('"', "\\\"")
        .replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_one_line_without_nul_and_not_too_long() {
        assert_eq!(fit("Città, 12 kN", 100), "Città, 12 kN");
        assert_eq!(fit("a\0b\nc\u{202e}", 100), "a\\u{0}b\\u{a}c\\u{202e}");
        assert_eq!(fit("àààà", 8), "àààà");
        assert_eq!(fit("ààààà", 8), "àà…");
        assert_eq!(fit(&"x".repeat(500), 200).len(), 200);
    }
}
