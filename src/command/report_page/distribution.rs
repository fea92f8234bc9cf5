//! Figures not over time: prior against posterior, force against temperature.

use super::axis::{self, minus};
use super::figure::Figure;
use super::markup::Markup;
use super::view::RodReport;
use crate::analysis::record_view::Density;

/// Most points of the temperature figure: beyond, every n-th period is drawn.
const SCATTER_POINTS: usize = 2000;

/// Height of a density in its own place, and of one on a sheet.
pub(super) const HIGH: f64 = 150.0;
pub(super) const LOW: f64 = 100.0;

/// Name of a quantity for people, its display unit, and the factor from SI to it.
pub fn quantity(key: &str) -> (&str, &'static str, f64) {
    match key {
        "axial_force_n" => ("axial force", "kN", 1e-3),
        "youngs_modulus_pa" => ("Young's modulus", "GPa", 1e-9),
        "density_kg_m3" => ("density", "kg/m\u{b3}", 1.0),
        "side_m" => ("side", "mm", 1e3),
        "diameter_m" => ("diameter", "mm", 1e3),
        "width_m" => ("width", "mm", 1e3),
        "height_m" => ("height", "mm", 1e3),
        "flexural_rigidity_n_m2" => ("flexural rigidity", "kN m\u{b2}", 1e-3),
        "mass_per_length_kg_m" => ("mass per length", "kg/m", 1.0),
        "spring_left_n_m" => ("left support stiffness", "kN m/rad", 1e-3),
        "spring_right_n_m" => ("right support stiffness", "kN m/rad", 1e-3),
        "fixity_left" => ("left fixity", "0 hinge, 1 clamp", 1.0),
        "fixity_right" => ("right fixity", "0 hinge, 1 clamp", 1.0),
        "length_m" => ("length", "m", 1.0),
        other => (other, "SI", 1.0),
    }
}

/// Prior against posterior of one quantity, the latest record and the baseline's first.
pub(super) fn density(rod: &RodReport, latest: &Density, height: f64, id: &str) -> Markup {
    let (name, unit, factor) = quantity(&latest.quantity);
    let earlier = rod
        .baseline
        .as_ref()
        .filter(|_| rod.latest.as_ref().map(|l| l.start) != rod.baseline.as_ref().map(|b| b.start))
        .and_then(|baseline| baseline.densities.iter().find(|d| d.quantity == latest.quantity))
        .filter(|earlier| (earlier.low, earlier.high) == (latest.low, latest.high));
    let x = (latest.low * factor, latest.high * factor);
    let curves = [
        Some(&latest.prior),
        Some(&latest.posterior),
        earlier.map(|earlier| &earlier.posterior),
    ];
    let top = curves.iter().flatten().flat_map(|curve| curve.iter().copied());
    let y = (
        0.0,
        1.08 * axis::span(top, 0.0).map_or(1.0, |(_, high)| high.max(1e-9)),
    );
    let mut figure = Figure::half(x, y, height);
    let few = axis::numbers(x, 4);
    // One number on an axis has no scale.
    let ticks = if few.len() < 2 { axis::numbers(x, 8) } else { few };
    figure.x_axis(&ticks, &format!("{name} [{unit}]"));
    figure.y_axis(&[], "probability density");
    let points = |curve: &[f64]| -> Vec<(f64, f64)> {
        let step = (x.1 - x.0) / curve.len().saturating_sub(1).max(1) as f64;
        curve
            .iter()
            .enumerate()
            .map(|(i, d)| (x.0 + i as f64 * step, *d))
            .collect()
    };
    let area = |curve: &[f64]| -> Vec<(f64, f64, f64)> {
        points(curve).into_iter().map(|(x, d)| (x, 0.0, d)).collect()
    };
    figure.band("c7", &area(&latest.prior));
    figure.line("c7", points(&latest.prior).into_iter());
    figure.band("c1", &area(&latest.posterior));
    figure.line("c1", points(&latest.posterior).into_iter());
    if let Some(earlier) = earlier {
        figure.line("c2 dashed", points(&earlier.posterior).into_iter());
    }
    figure.key("c7", "prior");
    figure.key("c1", "posterior");
    if earlier.is_some() {
        figure.key("c2 dashed", "baseline's first");
    }
    let title = format!("Prior and posterior of the {name} of rod {}", rod.rod);
    let (mean, sd) = latest.posterior_mean_sd;
    let about = format!(
        "Densities of what was known before and after the latest record; posterior mean {} {unit}, standard deviation {} {unit}.",
        significant(mean * factor),
        significant(sd * factor)
    );
    figure.finish(id, &title, &about)
}

/// Mean and standard deviation, both to two digits of the latter.
pub(super) fn mean_and_sd(mean: f64, sd: f64) -> String {
    let digits = if sd > 0.0 && sd.is_finite() {
        sd.log10().floor()
    } else {
        0.0
    };
    let decimals = (1.0 - digits).clamp(0.0, 6.0) as usize;
    minus(&format!("{mean:.decimals$} \u{b1} {sd:.decimals$}"))
}

/// About three significant digits.
pub(super) fn significant(value: f64) -> String {
    let digits = if value == 0.0 || !value.is_finite() {
        0.0
    } else {
        value.abs().log10().floor()
    };
    let decimals = (2.0 - digits).clamp(0.0, 6.0) as usize;
    minus(&format!("{value:.decimals$}"))
}

/// Relative force of each period against its temperature, with the line of the baseline's force.
pub(super) fn thermal(rod: &RodReport, id: &str) -> Option<Markup> {
    let segment = rod.segment()?;
    let reference = segment.reference_c?;
    let points: Vec<(f64, f64)> = rod
        .periods
        .iter()
        .filter(|(number, _)| *number == segment.number)
        .filter_map(|(_, period)| Some((period.charted.as_ref()?.temperature_c?, 100.0 * period.delta)))
        .collect();
    let every = points.len().div_ceil(SCATTER_POINTS).max(1);
    let x = axis::span(points.iter().map(|point| point.0), 0.05)?;
    let y = axis::span(points.iter().map(|point| point.1), 0.08)?;
    let mut figure = Figure::new(x, y, 200.0);
    figure.x_axis(&axis::numbers(x, 8), "temperature of the rod [\u{b0}C]");
    figure.y_axis(&axis::numbers(y, 5), "change of force [%]");
    figure.dots("c1", points.iter().step_by(every).copied());
    figure.key("c1", "periods");
    if let Some(line) = &rod.thermal {
        let slope = 100.0 * line.slope_per_k;
        // Through the baseline, not through the latest level, which a loss has moved.
        let at = |celsius: f64| (celsius, slope * (celsius - reference));
        figure.line("c2", [at(x.0), at(x.1)].into_iter());
        figure.key(
            "c2",
            &format!("the baseline's force: {} % per kelvin", significant(slope)),
        );
    }
    let title = format!("Force of rod {} against temperature", rod.rod);
    Some(figure.finish(id, &title, "Relative change of force of each period in percent against the rod's temperature, with the line of the baseline's force, as learned."))
}
