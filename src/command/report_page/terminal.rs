//! A small plot in the terminal: a curve in braille dots, its axes in text.

use super::axis;
use std::fmt::Write;

/// Most characters of the plot's height.
const ROWS: usize = 10;
/// Width of the ticks' texts left of the plot, in characters.
const LEFT: usize = 9;
/// Width of the widest plot, in characters.
const WIDEST: usize = 100;
/// Width of the narrowest plot, in characters.
const NARROWEST: usize = 20;
/// The empty braille character; its eight lowest bits are its dots.
const BRAILLE: u32 = 0x2800;
/// Bit of each dot of a braille character: \[column\]\[row\].
const DOTS: [[u32; 4]; 2] = [[0x01, 0x02, 0x04, 0x40], [0x08, 0x10, 0x20, 0x80]];

/// Content of a plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Sketch<'t> {
    /// Title, with the unit of the vertical axis.
    pub title: &'t str,
    /// Points, ascending in x; those that are not finite are left out.
    pub points: &'t [(f64, f64)],
    /// True if x is Unix time in seconds.
    pub is_time: bool,
    /// Labels above positions of x.
    pub labels: &'t [(f64, String)],
}

impl Sketch<'_> {
    /// The plot as lines of at most `width` characters; empty for fewer than two points.
    pub fn draw(&self, width: usize) -> String {
        let points: Vec<(f64, f64)> = self
            .points
            .iter()
            .copied()
            .filter(|(x, y)| x.is_finite() && y.is_finite())
            .collect();
        let columns = width.saturating_sub(LEFT + 1).min(WIDEST);
        let xs = (points.first(), points.last());
        let (Some(first), Some(last)) = xs else {
            return String::new();
        };
        let across = (first.0, last.0);
        let Some(mut up) = axis::span(points.iter().map(|point| point.1), 0.05) else {
            return String::new();
        };
        if up.0 >= up.1 {
            // A level line goes in the middle.
            let half = 0.01 * up.0.abs() + f64::MIN_POSITIVE;
            up = (up.0 - half, up.1 + half);
        }
        if across.0 >= across.1 || columns < NARROWEST {
            return String::new();
        }
        let mut cells = vec![0_u32; columns * ROWS];
        let place = |(x, y): (f64, f64)| {
            let along = (x - across.0) / (across.1 - across.0) * (2 * columns - 1) as f64;
            let down = (up.1 - y) / (up.1 - up.0) * (4 * ROWS - 1) as f64;
            (along, down)
        };
        let mut dot = |along: f64, down: f64| {
            let (x, y) = (along.round().max(0.0) as usize, down.round().max(0.0) as usize);
            if let Some(cell) = cells.get_mut((y / 4) * columns + x / 2)
                && x / 2 < columns
            {
                *cell |= DOTS[x % 2][y % 4];
            }
        };
        for pair in points.windows(2) {
            let (from, to) = (place(pair[0]), place(pair[1]));
            // One dot at least in each column and row between the two.
            let steps = (to.0 - from.0).abs().max((to.1 - from.1).abs()).ceil().max(1.0);
            for step in 0..=steps as usize {
                let share = step as f64 / steps;
                dot(from.0 + share * (to.0 - from.0), from.1 + share * (to.1 - from.1));
            }
        }
        self.lines(&cells, columns, across, up)
    }

    fn lines(&self, cells: &[u32], columns: usize, across: (f64, f64), up: (f64, f64)) -> String {
        let column =
            |x: f64| ((x - across.0) / (across.1 - across.0) * (columns - 1) as f64).round() as usize;
        let mut out = format!("  {}\n", self.title);
        if !self.labels.is_empty() {
            let inside = self
                .labels
                .iter()
                .filter(|(x, _)| across.0 <= *x && *x <= across.1);
            let texts = inside.map(|(x, text)| (column(*x), text.as_str()));
            // Writing to a string cannot fail.
            let _ = writeln!(out, "{:LEFT$} {}", "", beside(texts, columns));
        }
        let ticks = axis::numbers(up, 5);
        for (row, line) in cells.chunks(columns).enumerate() {
            let middle = |at: f64| ((up.1 - at) / (up.1 - up.0) * (ROWS - 1) as f64).round() as usize;
            let tick = ticks.iter().find(|tick| middle(tick.at) == row);
            let text = tick.map_or("", |tick| tick.label.as_str());
            let dots: String = line
                .iter()
                .filter_map(|bits| char::from_u32(BRAILLE + bits))
                .collect();
            let edge = if tick.is_some() { '┤' } else { '│' };
            let _ = writeln!(out, "{text:>LEFT$}{edge}{dots}");
        }
        let count = (columns / 16).max(2);
        let ticks = if self.is_time {
            axis::dates(across, count)
        } else {
            axis::numbers(across, count)
        };
        let texts = ticks.iter().map(|tick| (column(tick.at), tick.label.as_str()));
        let _ = writeln!(out, "{:LEFT$}└{}", "", "─".repeat(columns));
        let _ = writeln!(out, "{:LEFT$} {}", "", beside(texts, columns));
        out
    }
}

/// Texts centred at their columns; one that would touch the previous one is left out.
fn beside<'t>(texts: impl Iterator<Item = (usize, &'t str)>, columns: usize) -> String {
    let mut line = String::new();
    for (middle, text) in texts {
        let length = text.chars().count();
        let (taken, room) = (line.chars().count(), columns.saturating_sub(length));
        let start = middle.saturating_sub(length / 2).min(room);
        if taken == 0 || start > taken {
            line.extend(std::iter::repeat_n(' ', start.saturating_sub(taken)));
            line.push_str(text);
        }
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rising_line_goes_from_corner_to_corner() {
        let points: Vec<(f64, f64)> = (0..=40).map(|i| (f64::from(i), f64::from(i))).collect();
        let sketch = Sketch {
            title: "level [dB]",
            points: &points,
            is_time: false,
            labels: &[(20.0, "2: 20.0".to_owned()), (20.5, "left out".to_owned())],
        };
        let text = sketch.draw(60);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2 + ROWS + 2, "{text}");
        assert!(
            lines[1].contains("2: 20.0") && !lines[1].contains("left"),
            "{text}"
        );
        let first_dot = |line: &str| line.chars().skip(LEFT + 1).position(|c| c as u32 > BRAILLE);
        let dots: Vec<Option<usize>> = lines[2..2 + ROWS].iter().map(|line| first_dot(line)).collect();
        assert!(
            dots[0] > dots[ROWS / 2] && dots[ROWS / 2] > dots[ROWS - 1],
            "{text}"
        );
        assert!(dots.iter().all(Option::is_some), "{text}");
        assert!(lines.iter().all(|line| line.chars().count() <= 60), "{text}");
    }

    #[test]
    fn nothing_to_draw_is_no_trouble() {
        for points in [
            &[][..],
            &[(1.0, 2.0)],
            &[(1.0, 2.0), (1.0, 3.0)],
            &[(0.0, f64::NAN), (1.0, 1.0)],
        ] {
            let sketch = Sketch {
                title: "",
                points,
                is_time: true,
                labels: &[],
            };
            assert_eq!(sketch.draw(80), "");
        }
        let flat = Sketch {
            title: "flat",
            points: &[(0.0, 5.0), (1.0, 5.0)],
            is_time: false,
            labels: &[],
        };
        assert!(flat.draw(80).lines().count() > ROWS);
        assert_eq!(flat.draw(10), "");
    }
}
