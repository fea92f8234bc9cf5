//! Tables with their captions, and the kinds of their cells.

use super::markup::Markup;

/// A cell of a table.
pub(super) enum Cell {
    /// Plain text.
    Text(String),
    /// Text that stays on one line.
    Line(String),
    /// A value with an interval, a temperature or a time: wrapped only between them.
    Value(String),
    /// A state with its style.
    State(&'static str, String),
    /// A link within the page: target and text.
    Link(String, String),
}

/// A table with its caption, scrollable on a narrow screen.
pub(super) fn table(html: &mut Markup, caption: &str, header: &[&str], rows: &[Vec<Cell>]) {
    html.element("div", &[("class", "scroll"), ("tabindex", "0")], |div| {
        div.element("table", &[], |table| {
            table.leaf("caption", &[], caption);
            table.element("thead", &[], |head| {
                head.element("tr", &[], |row| {
                    for name in header {
                        row.leaf("th", &[("scope", "col")], name);
                    }
                });
            });
            table.element("tbody", &[], |body| {
                for cells in rows {
                    body.element("tr", &[], |row| cells.iter().for_each(|cell| write(row, cell)));
                }
            });
        });
    });
}

fn write(row: &mut Markup, cell: &Cell) {
    match cell {
        Cell::Text(text) => row.leaf("td", &[], text),
        Cell::Line(text) => row.leaf("td", &[("class", "nowrap")], text),
        Cell::Value(text) => row.element("td", &[], |td| {
            for (i, part) in parts(text).iter().enumerate() {
                if i > 0 {
                    td.text(" ");
                }
                td.leaf("span", &[("class", "nowrap")], part);
            }
        }),
        Cell::State(class, text) => row.element("td", &[], |td| {
            td.leaf("span", &[("class", &format!("state {class}"))], text);
        }),
        Cell::Link(to, text) => row.element("td", &[("class", "nowrap")], |td| {
            td.leaf("a", &[("href", to)], text);
        }),
    }
}

/// Splits a value from its interval, temperature or time.
fn parts(text: &str) -> Vec<&str> {
    let mut parts = Vec::new();
    let mut rest = text;
    // The first character is never a break, so that every part is shorter than the rest.
    while let Some(place) = [" [", " at ", " since ", ", ", "; "]
        .iter()
        .filter_map(|mark| rest.find(mark))
        .filter(|place| *place > 0)
        .min()
    {
        let place = place + usize::from(!rest[place..].starts_with(' '));
        parts.push(&rest[..place]);
        rest = rest[place..].trim_start();
    }
    parts.push(rest);
    parts
}
