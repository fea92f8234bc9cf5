//! Horizontal bars of shares with their errors, as an SVG file of its own.

use super::markup::Markup;

/// One bar.
pub struct Share {
    /// Name, on the left.
    pub name: String,
    /// Length of the bar, 0 to 1.
    pub share: f64,
    /// Its standard error.
    pub error: f64,
    /// Words behind the value; may be empty.
    pub note: String,
}

const STYLE: &str = "svg{color-scheme:light dark;--ink:#1b2026;--soft:#5b6672;--grid:#d9dee4;--paper:#fff;--bar:#1f6cb0}\
@media (prefers-color-scheme:dark){svg{--ink:#e6eaee;--soft:#9ba7b3;--grid:#39424b;--paper:#14181c;--bar:#6db3f2}}\
text{fill:var(--ink);font:13px system-ui,sans-serif}.soft{fill:var(--soft)}.end{text-anchor:end}.mid{text-anchor:middle}\
.paper{fill:var(--paper)}.bar{fill:var(--bar);opacity:.75}.grid{stroke:var(--grid);fill:none}.error{stroke:var(--ink);fill:none}";

const WIDTH: f64 = 1000.0;
const LEFT: f64 = 430.0;
const RIGHT: f64 = 200.0;
const TOP: f64 = 64.0;
const ROW: f64 = 26.0;

/// The drawing, under a title and a line about what the shares are of.
pub fn shares(title: &str, of: &str, rows: &[Share]) -> String {
    let bottom = TOP + ROW * rows.len() as f64;
    let x = |share: f64| LEFT + share.clamp(0.0, 1.0) * (WIDTH - LEFT - RIGHT);
    let mut svg = Markup::new();
    let size = format!("0 0 {WIDTH} {}", bottom + 34.0);
    let frame = [
        ("xmlns", "http://www.w3.org/2000/svg"),
        ("viewBox", size.as_str()),
        ("role", "img"),
    ];
    svg.element("svg", &frame, |svg| {
        svg.leaf("title", &[], title);
        svg.leaf("style", &[], STYLE);
        svg.empty(
            "rect",
            &[("class", "paper"), ("width", "100%"), ("height", "100%")],
        );
        let text = |svg: &mut Markup, class: &str, x: f64, y: f64, said: &str| {
            let (x, y) = (format!("{x:.1}"), format!("{y:.1}"));
            svg.leaf("text", &[("class", class), ("x", &x), ("y", &y)], said);
        };
        text(svg, "", 16.0, 24.0, title);
        text(svg, "soft", 16.0, 44.0, of);
        for percent in [0, 25, 50, 75, 100] {
            let at = x(f64::from(percent) / 100.0);
            svg.empty(
                "path",
                &[("class", "grid"), ("d", &format!("M{at:.1} {TOP}V{bottom}"))],
            );
            text(svg, "soft mid", at, bottom + 20.0, &format!("{percent} %"));
        }
        for (i, row) in rows.iter().enumerate() {
            let middle = TOP + ROW * (i as f64 + 0.5);
            text(svg, "end", LEFT - 10.0, middle + 4.5, &row.name);
            let bar = [
                ("class", "bar"),
                ("x", &format!("{LEFT}")),
                ("y", &format!("{:.1}", middle - 8.0)),
                ("width", &format!("{:.1}", x(row.share) - LEFT)),
                ("height", "16"),
            ];
            svg.empty("rect", &bar);
            let (low, high) = (x(row.share - row.error), x(row.share + row.error));
            svg.empty(
                "path",
                &[
                    ("class", "error"),
                    ("d", &format!("M{low:.1} {middle:.1}H{high:.1}")),
                ],
            );
            let value = format!("{:.0} %  {}", 100.0 * row.share, row.note);
            text(svg, "", high + 8.0, middle + 4.5, value.trim_end());
        }
    });
    svg.into_string()
}
