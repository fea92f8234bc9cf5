//! Map of the sites: where each stands and what is worst about it, drawn without any map server.

use super::page::escaped;
use super::sites::{SiteRow, Worst};
use crate::config::settings::hub::SiteSettings;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Width of the drawing, and the least and largest height.
const WIDTH: f64 = 1000.0;
const HEIGHTS: (f64, f64) = (320.0, 460.0);
/// Room around the outermost sites, and least extent of the map \[degrees of latitude\].
const MARGIN: f64 = 60.0;
const LEAST_DEGREES: f64 = 0.02;
/// Length of a degree of latitude \[km\].
const KM_OF_DEGREE: f64 = 111.2;
/// Most names written beside their sites; the worst have them.
const NAMED: usize = 40;
/// Intervals of the lines of latitude and longitude, and lengths of the scale, as multiples of a power of ten.
const STEPS: [f64; 3] = [1.0, 2.0, 5.0];

/// The map of the sites that have a position; `None` if none has. East is stretched by the cosine of the middle latitude, so that
/// distances are right there and nearly so elsewhere.
pub fn svg(rows: &[SiteRow], listed: &[SiteSettings]) -> Option<String> {
    let positions: BTreeMap<&str, [f64; 2]> = listed
        .iter()
        .filter_map(|site| Some((site.name.as_str(), site.position?)))
        .collect();
    let mut placed: Vec<(&SiteRow, [f64; 2])> = rows
        .iter()
        .filter_map(|row| Some((row, *positions.get(row.site.as_str())?)))
        .collect();
    let frame = Frame::of(placed.iter().map(|(_, position)| *position))?;
    let mut out = format!(
        "<svg id=\"map\" viewBox=\"0 0 {WIDTH:.0} {:.0}\" role=\"img\" aria-label=\"Map of {} sites\">",
        frame.height,
        placed.len()
    );
    frame.draw_lines(&mut out);
    // Writing to a string cannot fail.
    placed.reverse();
    let named = placed.len().saturating_sub(NAMED);
    // The list is worst first; what is worse is drawn over what is better.
    for (place, (row, position)) in placed.iter().enumerate() {
        let [x, y] = frame.point(*position);
        let (name, code) = (escaped(&row.site), row.worst.code());
        let _ = write!(
            out,
            "<a href=\"sites/{name}/\"><circle class={code} cx={x:.1} cy={y:.1} r=\"{}\"><title>{name}: {code}</title></circle>",
            if row.worst >= Worst::NotMonitoring { 8 } else { 6 }
        );
        if place >= named {
            let (dx, anchor) = if x > WIDTH - 150.0 {
                (-11.0, "end")
            } else {
                (11.0, "start")
            };
            let _ = write!(
                out,
                "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{name}</text>",
                x + dx,
                y + 4.5
            );
        }
        out += "</a>";
    }
    let missing = rows.len() - placed.len();
    out += "</svg>";
    if missing > 0 {
        let _ = write!(
            out,
            "<p><small>{missing} sites without a position in the configuration</small></p>"
        );
    }
    Some(out)
}

/// The part of the Earth that is drawn.
struct Frame {
    /// Middle latitude and longitude \[degrees\].
    middle: [f64; 2],
    /// Length of a degree of latitude in the drawing, and of one of longitude.
    degree: [f64; 2],
    height: f64,
}

impl Frame {
    fn of(positions: impl Iterator<Item = [f64; 2]>) -> Option<Self> {
        let mut range: Option<[[f64; 2]; 2]> = None;
        for at in positions {
            let [low, high] = range.unwrap_or([at, at]);
            let join = |f: fn(f64, f64) -> f64, a: [f64; 2]| [f(a[0], at[0]), f(a[1], at[1])];
            range = Some([join(f64::min, low), join(f64::max, high)]);
        }
        let [low, high] = range?;
        let middle = [0, 1].map(|axis| f64::midpoint(low[axis], high[axis]));
        let stretch = middle[0].to_radians().cos().max(0.05);
        let extent = [
            (high[0] - low[0]).max(LEAST_DEGREES),
            ((high[1] - low[1]) * stretch).max(LEAST_DEGREES),
        ];
        let room = (WIDTH - 2.0 * MARGIN, HEIGHTS.1 - 2.0 * MARGIN);
        let degree = (room.0 / extent[1]).min(room.1 / extent[0]);
        let height = (extent[0] * degree + 2.0 * MARGIN).clamp(HEIGHTS.0, HEIGHTS.1);
        Some(Self {
            middle,
            degree: [degree, degree * stretch],
            height,
        })
    }

    /// Place of a position in the drawing.
    fn point(&self, [latitude, longitude]: [f64; 2]) -> [f64; 2] {
        [
            WIDTH / 2.0 + (longitude - self.middle[1]) * self.degree[1],
            self.height / 2.0 - (latitude - self.middle[0]) * self.degree[0],
        ]
    }

    /// Lines of latitude and longitude with their degrees, and a scale.
    fn draw_lines(&self, out: &mut String) {
        for (axis, size) in [(0, self.height), (1, WIDTH)] {
            let (step, digits) = round(120.0 / self.degree[axis]);
            let half = size / 2.0 / self.degree[axis];
            let (from, to) = (self.middle[axis] - half, self.middle[axis] + half);
            let mut index = (from / step).ceil();
            while index * step <= to {
                let value = index * step;
                index += 1.0;
                let mut at = self.middle;
                at[axis] = value;
                let [x, y] = self.point(at);
                let hemisphere = [["S", "N"], ["W", "E"]][axis][usize::from(value >= 0.0)];
                let text = format!("{:.digits$}° {hemisphere}", value.abs());
                let _ = if axis == 0 {
                    // Above the edge there is no room for it.
                    let text = if y > 18.0 { text } else { String::new() };
                    write!(
                        out,
                        "<path class=grid d=\"M0 {y:.1}H{WIDTH:.0}\"/><text class=grid x=\"4\" y=\"{:.1}\">{text}</text>",
                        y - 4.0
                    )
                } else {
                    write!(
                        out,
                        "<path class=grid d=\"M{x:.1} 0V{h:.0}\"/><text class=grid x=\"{:.1}\" y=\"{:.1}\">{text}</text>",
                        x + 4.0,
                        self.height - 6.0,
                        h = self.height
                    )
                };
            }
        }
        let (km, digits) = round(120.0 / self.degree[0] * KM_OF_DEGREE);
        let length = km / KM_OF_DEGREE * self.degree[0];
        let (right, y) = (WIDTH - 20.0, 24.0);
        let _ = write!(
            out,
            "<path class=scale d=\"M{:.1} {y}H{right}\"/><text class=scale x=\"{right}\" y=\"{:.0}\" text-anchor=\"end\">{km:.digits$} km</text>",
            right - length,
            y - 6.0
        );
    }
}

/// The smallest of 1, 2, 5, 10, … that is at least `least`, and the decimals it needs.
fn round(least: f64) -> (f64, usize) {
    let power = least.log10().floor();
    let unit = 10f64.powf(power);
    let found = STEPS
        .iter()
        .map(|step| step * unit)
        .find(|step| *step >= least * (1.0 - 1e-9));
    let found = found.unwrap_or(10.0 * unit);
    (found, (-found.log10()).ceil().max(0.0) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_round_and_large_enough() {
        for (least, step, digits) in [
            (0.013, 0.02, 2),
            (0.1, 0.1, 1),
            (0.6, 1.0, 0),
            (3.0, 5.0, 0),
            (51.0, 100.0, 0),
        ] {
            let (found, decimals) = round(least);
            assert!((found - step).abs() < 1e-9 * step, "{least}: {found}");
            assert_eq!(decimals, digits, "{least}");
        }
    }

    #[test]
    fn distances_are_right_and_every_site_is_inside() {
        // Todi to Gubbio: 63.4 km by the great circle on a sphere of 6371 km; Todi to Siracusa is 670 km.
        let (todi, gubbio, siracusa) = ([42.782, 12.407], [43.3517, 12.5773], [37.0755, 15.2866]);
        let km = |frame: &Frame, a: [f64; 2], b: [f64; 2]| {
            let [p, q] = [a, b].map(|at| frame.point(at));
            (p[0] - q[0]).hypot(p[1] - q[1]) / frame.degree[0] * KM_OF_DEGREE
        };
        let great_circle = |a: [f64; 2], b: [f64; 2]| {
            let [[p, l], [q, m]] = [a, b].map(|at| at.map(f64::to_radians));
            6371.0 * (p.sin() * q.sin() + p.cos() * q.cos() * (l - m).cos()).acos()
        };
        let near = Frame::of([todi, gubbio].into_iter()).unwrap();
        let exact = great_circle(todi, gubbio);
        assert!((km(&near, todi, gubbio) / exact - 1.0).abs() < 0.002, "{exact}");
        // Over six degrees of latitude the stretch of the middle is off by some percent at the ends.
        let far = Frame::of([todi, gubbio, siracusa].into_iter()).unwrap();
        let exact = great_circle(todi, siracusa);
        assert!((km(&far, todi, siracusa) / exact - 1.0).abs() < 0.02, "{exact}");
        for frame in [&near, &far] {
            for at in [todi, gubbio] {
                let [x, y] = frame.point(at);
                assert!((20.0..WIDTH - 20.0).contains(&x) && (20.0..frame.height - 20.0).contains(&y));
            }
        }
        let single = Frame::of([todi].into_iter()).unwrap();
        assert_eq!(single.point(todi), [WIDTH / 2.0, single.height / 2.0]);
        assert!(Frame::of(std::iter::empty()).is_none());
    }
}
