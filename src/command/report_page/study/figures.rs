//! The drawings of the study's page: densities, chains, cases, known rods.

use crate::analysis::lab::study::Part;
use crate::analysis::lab::study::density::{Grid, POINTS};
use crate::analysis::lab::study::estimate::Estimate;
use crate::analysis::lab::study::paper::{self, INFERRED};
use crate::analysis::lab::study::table2::THIN;
use crate::analysis::lab::study::table3::Row;
use crate::analysis::rod::prior::RodPrior;
use crate::command::report_page::axis::{self, Tick};
use crate::command::report_page::distribution::quantity;
use crate::command::report_page::figure::{Figure, figure};
use crate::command::report_page::markup::Markup;

/// Colours of curves side by side.
pub(super) const COLOURS: [&str; 6] = ["c1", "c2", "c3", "c4", "c5", "c6"];

/// Densities of inferred quantity `i`: name, colour, values on the grid of its prior.
pub(super) fn densities(
    prior: &RodPrior,
    i: usize,
    curves: &[(String, &str, Vec<f64>)],
    truth: Option<f64>,
    id: &str,
) -> Markup {
    let (name, unit, factor) = quantity(INFERRED[i].key());
    let grid = Grid::of(&prior.priors()[i]);
    let x = (grid.low * factor, grid.at(POINTS - 1) * factor);
    // A spike at the end of the axis must not flatten the others.
    let mut tops: Vec<f64> = curves
        .iter()
        .map(|c| c.2.iter().copied().fold(0.0, f64::max))
        .collect();
    tops.sort_unstable_by(f64::total_cmp);
    let typical = tops.get(tops.len() / 2).copied().unwrap_or(1.0);
    let top = tops
        .into_iter()
        .filter(|top| *top <= 3.0 * typical)
        .fold(0.0, f64::max);
    let mut drawing = Figure::new(x, (0.0, 1.1 * top / factor), 170.0);
    drawing.x_axis(&axis::numbers(x, 8), &format!("{name} [{unit}]"));
    drawing.y_axis(&[], "probability density");
    for (label, class, values) in curves {
        let points = values
            .iter()
            .enumerate()
            .map(|(k, d)| (grid.at(k) * factor, d / factor));
        if *class == "c7" {
            let area: Vec<(f64, f64, f64)> = points.clone().map(|(x, d)| (x, 0.0, d)).collect();
            drawing.band("c7", &area);
        }
        drawing.line(class, points.step_by(2));
        drawing.key(class, label);
    }
    if let Some(truth) = truth {
        drawing.event("alarm", truth * factor, "truth");
    }
    drawing.finish(
        id,
        &format!("Densities of the {name}"),
        "Prior and posterior densities.",
    )
}

pub(super) fn traces(main: &mut Markup, part: &Part) {
    let chains = part.columns.iter().filter(|c| c.which.printed().is_some());
    for column in chains {
        let Some(traces) = column.runs.first().and_then(|run| run.traces.as_ref()) else {
            continue;
        };
        let id = format!("{}-{}", part.setting.key(), column.which.model);
        main.leaf("h3", &[], format!("Chains of {}", column.which.name()));
        let forces = traces.force.iter().flatten().map(|n| 1e-3 * n);
        let y = axis::span(forces, 0.05).unwrap_or((0.0, 1.0));
        let points = traces.force.iter().map(Vec::len).max().unwrap_or(1);
        let x = (0.0, (points * traces.every) as f64);
        let mut drawing = Figure::new(x, y, 150.0);
        drawing.x_axis(&axis::numbers(x, 8), "steps after the burn-in");
        drawing.y_axis(&axis::numbers(y, 4), "axial force [kN]");
        for (i, (chain, class)) in traces.force.iter().zip(COLOURS).enumerate() {
            let steps = chain.iter().enumerate();
            drawing.line(class, steps.map(|(k, n)| ((k * traces.every) as f64, 1e-3 * n)));
            drawing.key(class, &format!("chain {}", i + 1));
        }
        let title = "Traces of the axial force";
        figure(
            main,
            drawing.finish(&format!("{id}-trace"), title, "Axial force along some chains."),
            "",
        );
        let lags = traces.autocorrelation.iter().map(Vec::len).max().unwrap_or(1);
        let (x, y) = ((0.0, (lags.max(2) - 1) as f64 * THIN as f64), (-0.1, 1.0));
        let mut drawing = Figure::new(x, y, 130.0);
        drawing.x_axis(&axis::numbers(x, 8), "lag [steps]");
        drawing.y_axis(&axis::numbers(y, 4), "autocorrelation");
        drawing.level("zero", 0.0, "");
        for ((values, class), q) in traces.autocorrelation.iter().zip(COLOURS).zip(INFERRED) {
            drawing.line(
                class,
                values.iter().enumerate().map(|(k, r)| ((k * THIN) as f64, *r)),
            );
            drawing.key(class, quantity(q.key()).0);
        }
        let title = "Autocorrelation of the chains";
        figure(
            main,
            drawing.finish(&format!("{id}-acf"), title, "Autocorrelation against lag."),
            "",
        );
    }
}

pub(super) fn case_figure(part: &Part, which: usize, name: &str) -> Markup {
    let mut ours: Vec<(usize, f64, Estimate)> = Vec::new();
    let mut grey = Vec::new();
    let mut ticks = Vec::new();
    for (c, case) in part.cases.iter().enumerate() {
        let at = |i: usize| c as f64 + 0.2 * i as f64 - 0.3;
        ticks.push(Tick {
            at: c as f64,
            label: case.name.to_owned(),
        });
        for (i, apart) in case.quantities.iter().enumerate() {
            let (estimate, other) = match which {
                0 => (apart.divergence, Some(apart.chance.value)),
                1 => (apart.mean_ratio, apart.paper_mean_ratio.map(|p| p.value)),
                _ => (apart.cv_ratio, apart.paper_cv_ratio.map(|p| p.value)),
            };
            // Divergences span decades.
            let log = |value: f64| {
                if which == 0 {
                    10.0 * value.max(1e-6).log10()
                } else {
                    value
                }
            };
            let shown = Estimate {
                value: log(estimate.value),
                ..estimate
            };
            ours.push((i, at(i), shown));
            grey.extend(other.map(|value| (at(i), log(value))));
        }
    }
    let bars = which != 0;
    let ends = ours.iter().flat_map(|(_, _, e)| {
        let half = if bars && e.error.is_finite() { e.error } else { 0.0 };
        [e.value - half, e.value + half]
    });
    let y = axis::span(ends.chain(grey.iter().map(|g| g.1)), 0.1).unwrap_or((0.0, 1.0));
    let mut drawing = Figure::new((-0.5, part.cases.len() as f64 - 0.5), y, 150.0);
    drawing.x_axis(&ticks, "case");
    let scale = if bars {
        axis::numbers(y, 5)
    } else {
        axis::powers(y, 5)
    };
    drawing.y_axis(&scale, name);
    if bars {
        drawing.level("zero", 1.0, "");
    }
    drawing.dots("c7 large", grey.into_iter());
    for (q, class) in COLOURS.iter().take(INFERRED.len()).enumerate() {
        let own = || ours.iter().filter(|(i, _, _)| *i == q);
        if bars {
            let ends: Vec<(f64, f64, f64)> = own()
                .map(|(_, x, e)| (*x, e.value - e.error, e.value + e.error))
                .collect();
            drawing.bars(class, &ends);
        }
        drawing.dots(&format!("{class} large"), own().map(|(_, x, e)| (*x, e.value)));
        drawing.key(class, quantity(INFERRED[q].key()).0);
    }
    let id = format!("{}-f6-{which}", part.setting.key());
    drawing.finish(
        &id,
        &format!("Figure 6, {name}"),
        "Cases A to D, four quantities each.",
    )
}

pub(super) fn figure_8(part: &Part, ratio: bool) -> Markup {
    let value = |row: &Row, i: usize| {
        let cell = &row.quantities[i];
        if ratio {
            cell.mean.value / paper::TRUTH[i]
        } else {
            100.0 * cell.bmape.value
        }
    };
    let printed = |nf: usize, i: usize| paper::TABLE_3[nf - 1][i] / paper::TRUTH[i];
    let all = part.rows.iter().flat_map(|row| (0..4).map(move |i| (row, i)));
    let values = all.flat_map(|(row, i)| {
        let paper = if ratio {
            printed(row.frequencies, i)
        } else {
            value(row, i)
        };
        [value(row, i), paper]
    });
    let y = axis::span(values, 0.08).unwrap_or((0.0, 1.0));
    let mut drawing = Figure::new((0.8, 5.2), y, 170.0);
    drawing.x_axis(&axis::numbers((0.8, 5.2), 5), "number of frequencies");
    let name = if ratio {
        "posterior mean / truth"
    } else {
        "BMAPE [%]"
    };
    drawing.y_axis(&axis::numbers(y, 5), name);
    if ratio {
        drawing.level("zero", 1.0, "");
    }
    for (i, class) in COLOURS.iter().take(INFERRED.len()).enumerate() {
        drawing.line(
            class,
            part.rows
                .iter()
                .map(|row| (row.frequencies as f64, value(row, i))),
        );
        if ratio {
            let dots = part
                .rows
                .iter()
                .map(|row| (row.frequencies as f64, printed(row.frequencies, i)));
            drawing.dots(&format!("{class} large"), dots);
        }
        drawing.key(class, quantity(INFERRED[i].key()).0);
    }
    let id = format!(
        "{}-f8-{}",
        part.setting.key(),
        if ratio { "ratio" } else { "bmape" }
    );
    drawing.finish(&id, name, "Against the number of frequencies, per quantity.")
}
