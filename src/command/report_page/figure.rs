//! One drawing: frame, axes, bands, lines and marks, as SVG whose colours the page's style sheet gives.

use super::axis::{Scale, Tick};
use super::markup::Markup;
use std::fmt::Write;

/// Width of a drawing over the whole page, in its own units; the page scales it.
const WIDTH: f64 = 760.0;
/// Width of a drawing next to another: letters keep their size.
const HALF_WIDTH: f64 = 380.0;
const LEFT: f64 = 64.0;
const HALF_LEFT: f64 = 26.0;
const RIGHT: f64 = 14.0;
/// Height of the key above the frame.
const TOP: f64 = 26.0;
const BOTTOM: f64 = 42.0;
/// Mean width of a character of the labels.
const CHARACTER: f64 = 6.4;
/// Number of rows over which labels of vertical marks are spread to avoid overlap.
const LABEL_ROWS: usize = 3;

/// Number of columns of the frame.
pub(super) const COLUMNS: usize = (WIDTH - LEFT - RIGHT) as usize;

/// A drawing under construction.
pub(super) struct Figure {
    x: Scale,
    y: Scale,
    width: f64,
    left: f64,
    height: f64,
    axes: Markup,
    marks: Markup,
    key: Markup,
    key_at: f64,
    rows: [f64; LABEL_ROWS],
    /// Boxes of labels that must not be covered: left, right, top, bottom.
    labels: Vec<[f64; 4]>,
}

impl Figure {
    /// A frame over these spans of data, `height` units high without axis labels.
    pub fn new(x: (f64, f64), y: (f64, f64), height: f64) -> Self {
        Self::sized(x, y, height, WIDTH, LEFT)
    }

    /// A frame that shares the page's width with another and has no numbers on its vertical axis.
    pub fn half(x: (f64, f64), y: (f64, f64), height: f64) -> Self {
        Self::sized(x, y, height, HALF_WIDTH, HALF_LEFT)
    }

    fn sized(x: (f64, f64), y: (f64, f64), height: f64, width: f64, left: f64) -> Self {
        Self {
            x: Scale::new(x, (left, width - RIGHT)),
            y: Scale::new(y, (TOP + height, TOP)),
            width,
            left,
            height,
            axes: Markup::new(),
            marks: Markup::new(),
            key: Markup::new(),
            key_at: left,
            rows: [f64::NEG_INFINITY; LABEL_ROWS],
            labels: Vec::new(),
        }
    }

    /// Draws the horizontal axis: ticks and label.
    pub fn x_axis(&mut self, ticks: &[Tick], label: &str) {
        let bottom = TOP + self.height;
        for tick in ticks.iter().filter(|tick| self.x.holds(tick.at)) {
            let x = self.x.place(tick.at);
            self.axes.empty(
                "path",
                &[("class", "grid"), ("d", &format!("M{x:.1} {TOP}V{bottom}"))],
            );
            // The outermost labels stay inside the drawing.
            let half = 0.5 * CHARACTER * tick.label.chars().count() as f64 + 4.0;
            let x = x.clamp(half, self.width - half);
            self.axes.leaf(
                "text",
                &[
                    ("x", &format!("{x:.1}")),
                    ("y", &format!("{}", bottom + 16.0)),
                    ("class", "mid"),
                ],
                &tick.label,
            );
        }
        let (x, y) = (self.left + 0.5 * (self.width - self.left - RIGHT), bottom + 34.0);
        self.axes.leaf(
            "text",
            &[
                ("x", &format!("{x}")),
                ("y", &format!("{y}")),
                ("class", "mid name"),
            ],
            label,
        );
    }

    /// Draws the vertical axis: ticks and label.
    pub fn y_axis(&mut self, ticks: &[Tick], label: &str) {
        let (left, right) = (self.left, self.width - RIGHT);
        for tick in ticks.iter().filter(|tick| self.y.holds(tick.at)) {
            let y = self.y.place(tick.at);
            self.axes.empty(
                "path",
                &[("class", "grid"), ("d", &format!("M{left} {y:.1}H{right}"))],
            );
            self.axes.leaf(
                "text",
                &[
                    ("x", &format!("{}", self.left - 6.0)),
                    ("y", &format!("{:.1}", y + 4.0)),
                    ("class", "end"),
                ],
                &tick.label,
            );
        }
        let middle = TOP + 0.5 * self.height;
        self.axes.leaf(
            "text",
            &[
                ("transform", &format!("translate(13 {middle}) rotate(-90)")),
                ("class", "mid name"),
            ],
            label,
        );
    }

    /// Draws the area between two lines, given as (x, low, high).
    pub fn band(&mut self, class: &str, points: &[(f64, f64, f64)]) {
        if points.len() < 2 {
            return self.bars(class, points);
        }
        let mut d = String::new();
        let ends = points
            .iter()
            .map(|p| (p.0, p.2))
            .chain(points.iter().rev().map(|p| (p.0, p.1)));
        self.trace(&mut d, ends);
        d.push('Z');
        self.marks
            .empty("path", &[("class", &format!("band {class}")), ("d", &d)]);
    }

    /// Draws a line through points (x, y).
    pub fn line(&mut self, class: &str, points: impl Iterator<Item = (f64, f64)>) {
        let mut d = String::new();
        self.trace(&mut d, points);
        if !d.is_empty() {
            self.marks
                .empty("path", &[("class", &format!("line {class}")), ("d", &d)]);
        }
    }

    /// Draws a dot at each point (x, y).
    pub fn dots(&mut self, class: &str, points: impl Iterator<Item = (f64, f64)>) {
        // Strokes of no length with round ends: one path however many dots.
        let mut d = String::new();
        for (x, y) in points {
            if let Some((x, y)) = self.place(x, y) {
                let _ = write!(d, "M{x:.1} {y:.1}h0");
            }
        }
        if !d.is_empty() {
            self.marks
                .empty("path", &[("class", &format!("dots {class}")), ("d", &d)]);
        }
    }

    /// Draws a vertical bar from low to high at each x.
    pub fn bars(&mut self, class: &str, points: &[(f64, f64, f64)]) {
        let mut d = String::new();
        for &(x, low, high) in points {
            if let (Some((x, low)), Some((_, high))) = (self.place(x, low), self.place(x, high)) {
                let _ = write!(d, "M{x:.1} {low:.1}V{high:.1}");
            }
        }
        if !d.is_empty() {
            self.marks
                .empty("path", &[("class", &format!("bars {class}")), ("d", &d)]);
        }
    }

    /// Draws a horizontal line through the frame, with a label at its left end.
    pub fn level(&mut self, class: &str, at: f64, label: &str) {
        let y = self.y.place(at);
        let (left, right) = (self.left, self.width - RIGHT);
        self.marks.empty(
            "path",
            &[
                ("class", &format!("level {class}")),
                ("d", &format!("M{left} {y:.1}H{right}")),
            ],
        );
        if !label.is_empty() {
            let y = if y - 4.0 < TOP + 10.0 { y + 13.0 } else { y - 4.0 };
            let place = [("x", &*format!("{}", left + 4.0)), ("y", &format!("{y:.1}"))];
            self.marks
                .leaf("text", &[place[0], place[1], ("class", class)], label);
        }
    }

    /// Draws a vertical line through the frame, with a label beside it at the top if there is room.
    pub fn event(&mut self, class: &str, at: f64, label: &str) {
        if !self.x.holds(at) {
            return;
        }
        let x = self.x.place(at);
        let (top, bottom) = (TOP, TOP + self.height);
        self.marks.empty(
            "path",
            &[
                ("class", &format!("event {class}")),
                ("d", &format!("M{x:.1} {top}V{bottom}")),
            ],
        );
        let width = CHARACTER * label.chars().count() as f64 + 8.0;
        let left = if x + width > self.width - RIGHT {
            x - width
        } else {
            x
        };
        if let Some(row) = self.rows.iter().position(|end| *end <= left) {
            self.rows[row] = left + width;
            let (x, y) = (left + 4.0, top + 13.0 + 14.0 * row as f64);
            let place = [("x", &*format!("{x:.1}")), ("y", &format!("{y}"))];
            self.marks
                .leaf("text", &[place[0], place[1], ("class", class)], label);
        }
    }

    /// Shades a stretch of the horizontal axis over the whole height.
    pub fn stretch(&mut self, class: &str, from: f64, to: f64, label: &str) {
        let (low, high) = self.x.data;
        if to < low || from > high {
            return;
        }
        let (from, to) = (self.x.place(from.max(low)), self.x.place(to.min(high)));
        let width = (to - from).max(1.0);
        self.marks.empty(
            "rect",
            &[
                ("class", &format!("stretch {class}")),
                ("x", &format!("{from:.1}")),
                ("y", &format!("{TOP}")),
                ("width", &format!("{width:.1}")),
                ("height", &format!("{}", self.height)),
            ],
        );
        if !label.is_empty() {
            let (x, y) = (from + 4.0, TOP + self.height - 6.0);
            let place = [("x", &*format!("{x:.1}")), ("y", &format!("{y}"))];
            self.marks.leaf(
                "text",
                &[place[0], place[1], ("class", &format!("soft {class}"))],
                label,
            );
        }
    }

    /// Draws a label at a point, above it or one line higher; left out if it would cover another of its kind.
    pub fn label_beside_others(&mut self, class: &str, at: (f64, f64), label: &str) {
        let Some((x, y)) = self.place(at.0, at.1) else {
            return;
        };
        if label.is_empty() {
            return;
        }
        let half = 0.5 * CHARACTER * label.chars().count() as f64 + 2.0;
        let x = x.clamp(self.left + half, self.width - RIGHT - half);
        let free = [7.0, 21.0]
            .into_iter()
            .map(|up| (y - up).max(TOP + 11.0))
            .find(|y| {
                let covers = |other: &[f64; 4]| {
                    x - half < other[1] && other[0] < x + half && y - 11.0 < other[3] && other[2] < y + 3.0
                };
                !self.labels.iter().any(covers)
            });
        if let Some(y) = free {
            self.labels.push([x - half, x + half, y - 11.0, y + 3.0]);
            let place = [("x", &*format!("{x:.1}")), ("y", &format!("{y:.1}"))];
            let class = format!("mid {class}");
            self.marks
                .leaf("text", &[place[0], place[1], ("class", class.trim_end())], label);
        }
    }

    /// Adds an entry of the key above the frame.
    pub fn key(&mut self, class: &str, label: &str) {
        let x = self.key_at;
        let d = format!("M{x:.1} 13h18");
        self.key
            .empty("path", &[("class", &format!("line {class}")), ("d", &d)]);
        let at = format!("{:.1}", x + 23.0);
        self.key.leaf("text", &[("x", &at), ("y", "17")], label);
        self.key_at = x + 23.0 + CHARACTER * label.chars().count() as f64 + 18.0;
    }

    /// The drawing, with a title and a description for those who cannot see it. `id` is unique in the page.
    pub fn finish(self, id: &str, title: &str, description: &str) -> Markup {
        let mut svg = Markup::new();
        let height = TOP + self.height + BOTTOM;
        let (title_id, about_id, clip_id) = (format!("{id}-t"), format!("{id}-d"), format!("{id}-c"));
        let attributes = [
            ("viewBox", &*format!("0 0 {} {height}", self.width)),
            ("role", "img"),
            ("aria-labelledby", &format!("{title_id} {about_id}")),
        ];
        let frame = [
            ("x", &*format!("{}", self.left)),
            ("y", &format!("{TOP}")),
            ("width", &format!("{}", self.width - self.left - RIGHT)),
            ("height", &format!("{}", self.height)),
        ];
        svg.element("svg", &attributes, |svg| {
            svg.leaf("title", &[("id", &title_id)], title);
            svg.leaf("desc", &[("id", &about_id)], description);
            svg.element("clipPath", &[("id", &clip_id)], |clip| clip.empty("rect", &frame));
            svg.append(self.axes);
            svg.element("g", &[("clip-path", &format!("url(#{clip_id})"))], |g| {
                g.append(self.marks)
            });
            let mut border = vec![("class", "frame")];
            border.extend(frame);
            svg.empty("rect", &border);
            svg.append(self.key);
        });
        svg
    }

    fn place(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let (x, y) = (self.x.place(x), self.y.place(y));
        // Far outside the frame a renderer's own arithmetic would fail.
        (x.is_finite() && y.is_finite()).then(|| (x.clamp(-1e4, 1e4), y.clamp(-1e4, 1e4)))
    }

    fn trace(&self, d: &mut String, points: impl Iterator<Item = (f64, f64)>) {
        let mut pen = 'M';
        for (x, y) in points {
            if let Some((x, y)) = self.place(x, y) {
                let _ = write!(d, "{pen}{x:.1} {y:.1}");
                pen = 'L';
            }
        }
    }
}

/// A drawing with its caption, if there is one.
pub(super) fn figure(html: &mut Markup, drawing: impl Into<Option<Markup>>, caption: &str) {
    let Some(drawing) = drawing.into() else { return };
    html.element("figure", &[], |figure| {
        // Narrow screens scroll the drawing, not the page; the keyboard can too.
        figure.element("div", &[("class", "scroll"), ("tabindex", "0")], |div| {
            div.append(drawing)
        });
        if !caption.is_empty() {
            figure.leaf("figcaption", &[], caption);
        }
    });
}
