//! Markup that is balanced and escaped by construction, for HTML and for the SVG within it.

use std::fmt::{Display, Write};

/// A document under construction: every element opened is closed, every text and attribute escaped.
#[derive(Debug, Default)]
pub struct Markup {
    text: String,
}

impl Markup {
    /// An empty document.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an element with the content that `content` adds.
    pub fn element(&mut self, name: &str, attributes: &[(&str, &str)], content: impl FnOnce(&mut Self)) {
        self.start(name, attributes);
        self.text.push('>');
        content(self);
        let _ = write!(self.text, "</{name}>");
        if BLOCKS.contains(&name) {
            self.text.push('\n');
        }
    }

    /// Adds an element that holds only text.
    pub fn leaf(&mut self, name: &str, attributes: &[(&str, &str)], text: impl Display) {
        self.element(name, attributes, |inside| inside.text(text));
    }

    /// Adds an element without content.
    pub fn empty(&mut self, name: &str, attributes: &[(&str, &str)]) {
        self.start(name, attributes);
        self.text.push_str("/>");
        if BLOCKS.contains(&name) {
            self.text.push('\n');
        }
    }

    /// Adds text, escaped.
    pub fn text(&mut self, text: impl Display) {
        escape(&mut self.text, &text.to_string());
    }

    /// Adds markup of this program unescaped: the style sheet, the document type.
    pub fn verbatim(&mut self, markup: &str) {
        self.text.push_str(markup);
    }

    /// Appends another document.
    pub fn append(&mut self, other: Self) {
        self.text.push_str(&other.text);
    }

    /// The document.
    pub fn into_string(self) -> String {
        self.text
    }

    fn start(&mut self, name: &str, attributes: &[(&str, &str)]) {
        self.text.push('<');
        self.text.push_str(name);
        for (key, value) in attributes {
            let _ = write!(self.text, " {key}=\"");
            escape(&mut self.text, value);
            self.text.push('"');
        }
    }
}

/// Elements that end a line of the source.
const BLOCKS: [&str; 24] = [
    "p",
    "tr",
    "table",
    "thead",
    "tbody",
    "section",
    "figure",
    "figcaption",
    "h1",
    "h2",
    "h3",
    "header",
    "footer",
    "main",
    "nav",
    "ul",
    "li",
    "div",
    "svg",
    "g",
    "head",
    "body",
    "meta",
    "title",
];

/// Escapes characters with a meaning in markup, and replaces those not allowed in a document.
fn escape(out: &mut String, text: &str) {
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\t' | '\n' | '\r' => out.push(' '),
            // Control characters, and marks that turn the direction of the text around them.
            c if c.is_control() || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}') => {
                out.push('\u{fffd}');
            }
            c => out.push(c),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_from_outside_becomes_markup() {
        let mut markup = Markup::new();
        let hostile = "</title><script>alert('x')</script>\u{0}\u{202e}&\"";
        markup.element("p", &[("title", hostile)], |p| p.text(hostile));
        let text = markup.into_string();
        assert_eq!(text.matches('<').count(), 2);
        assert!(!text.contains("<script") && !text.contains('\u{0}') && !text.contains('\u{202e}'));
        assert!(text.contains("&lt;script&gt;alert(&#39;x&#39;)"));
    }
}
