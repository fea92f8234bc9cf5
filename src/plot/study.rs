//! The paper's study as a page: which of its statements hold, then every table and figure beside it.

use super::axis::{self, Tick, minus};
use super::distribution::{quantity, significant};
use super::figure::Figure;
use super::markup::Markup;
use super::page::document;
use super::rod::{self, Cell};
use crate::bayes::RodPrior;
use crate::study::claims::{Verdict, likeliest_reason, likeliest_reason_of_table_3};
use crate::study::density::{Grid, POINTS};
use crate::study::estimate::{Comparison, DISAGREE, Estimate};
use crate::study::paper::{self, INFERRED};
use crate::study::predictive::{BINS, RATIO};
use crate::study::setting::Setting;
use crate::study::table2::{Column, Sampler, THIN};
use crate::study::{Part, Study};

const COLOURS: [&str; 6] = ["c1", "c2", "c3", "c4", "c5", "c6"];

/// The page. The same study gives the same bytes.
pub fn study(study: &Study) -> String {
    document("The paper, reproduced", |body| {
        body.element("header", &[], |header| {
            header.leaf("h1", &[], "The paper, reproduced");
            header.leaf(
                "p",
                &[("class", "about")],
                "Approximate Bayesian Computation for structural identification of ancient tie-rods using noisy modal data \
                 (Monchetti, Pepi, Viscardi, Gioffr\u{e9}), run by tirante. Differences are the paper's figure less ours in \
                 standard errors of one run; from three on they count as disagreement.",
            );
        });
        body.element("main", &[], |main| {
            overview(main, study);
            for part in &study.parts {
                setting(main, part);
            }
            emulators(main, study);
            sensitivity(main, study);
            beyond(main, study);
        });
        body.element("footer", &[], |footer| provenance(footer, study));
    })
}

fn overview(main: &mut Markup, study: &Study) {
    main.leaf("h2", &[], "What holds");
    let rows: Vec<Vec<Cell>> = study
        .score()
        .into_iter()
        .map(|(part, agree, all)| vec![Cell::Text(part), Cell::Text(format!("{agree} of {all}"))])
        .collect();
    let caption = format!("Printed figures within {DISAGREE} standard errors of ours.");
    rod::table(main, &caption, &["Table or figure", "Agree"], &rows);
    let rows: Vec<Vec<Cell>> = study
        .claims
        .iter()
        .map(|claim| {
            let state = match claim.verdict {
                Verdict::Holds => Cell::State("monitoring", "holds".to_owned()),
                Verdict::Fails => Cell::State("alarm-state", "does not hold".to_owned()),
            };
            vec![
                Cell::Text(claim.statement.clone()),
                Cell::Text(claim.source.to_owned()),
                state,
                Cell::Text(minus_signs(&claim.evidence)),
            ]
        })
        .collect();
    rod::table(
        main,
        "Statements of the paper, and of earlier checks of it, judged by the figures below.",
        &["Statement", "Who says it", "Verdict", "Figures"],
        &rows,
    );
}

fn setting(main: &mut Markup, part: &Part) {
    let prior = &part.setting.prior();
    let key = part.setting.key();
    main.leaf("h2", &[], format!("Setting {key}"));
    main.leaf("p", &[], format!("That is: {}.", part.setting.about()));
    main.leaf("h3", &[], "Table 2: posterior of the real record");
    for column in &part.columns {
        table_2(main, part.setting, column);
    }
    main.leaf("h3", &[], "Figure 5: posterior densities");
    let shown: Vec<&Column> = part
        .columns
        .iter()
        .filter(|c| c.which.printed().is_some())
        .collect();
    for i in 0..INFERRED.len() {
        let mut curves = vec![(
            "prior".to_owned(),
            "c7",
            Grid::of(&prior.priors()[i]).prior(&prior.priors()[i]),
        )];
        for (column, colour) in shown.iter().zip(COLOURS) {
            curves.push((column.which.name(), colour, column.density(i)));
        }
        figure(
            main,
            densities(prior, i, &curves, None, &format!("{key}-f5-{i}")),
            "",
        );
    }
    traces(main, part);
    main.leaf("h3", &[], "Figure 6: how far the columns are apart");
    for (which, name) in ["divergence", "ratio of means", "ratio of CVs"]
        .iter()
        .enumerate()
    {
        figure(main, case_figure(part, which, name), "");
    }
    main.leaf(
        "p",
        &[("class", "about")],
        "Where the ratios disagree, the columns of Table 2 they are made of do. Dots with bars: ours, one standard deviation between runs. Grey dots: in the first figure two runs of the same column, what \
         chance alone gives; in the others the paper's ratio, from its Table 2. Cases: A, MCMC on elements against MCMC on the \
         chaos; B, ABC likewise; C, MCMC against ABC on elements; D, MCMC against ABC on the chaos.",
    );
    main.leaf("h3", &[], "Table 3: a rod whose truth is known");
    let header = [
        "Frequencies",
        "Quantity",
        "Paper",
        "Ours",
        "Difference",
        "BMAPE [%]",
    ];
    let comparisons = part.rows.iter().flat_map(|row| {
        let all = crate::study::table3::comparisons(row, part.setting);
        row.quantities.iter().zip(INFERRED).filter_map(move |(cell, q)| {
            let mean = all
                .iter()
                .find(|c| c.quantity == q.key() && c.statistic == "mean")?
                .clone();
            Some((row.frequencies, mean, cell.bmape))
        })
    });
    let rows: Vec<Vec<Cell>> = comparisons
        .map(|(count, mean, bmape)| {
            let mut cells = vec![Cell::Text(count.to_string())];
            cells.extend(compared(&mean));
            cells.push(Cell::Line(with_error(&bmape, 100.0)));
            cells
        })
        .collect();
    rod::table(
        main,
        "Posterior means with the first one to five frequencies.",
        &header,
        &rows,
    );
    for row in &part.rows {
        let all = crate::study::table3::comparisons(row, part.setting);
        let off: Vec<&str> = all
            .iter()
            .filter(|c| c.disagrees() == Some(true))
            .map(|c| quantity(&c.quantity).0)
            .collect();
        if !off.is_empty() {
            let reason = likeliest_reason_of_table_3(row.frequencies);
            let text = format!("nf = {}: {} disagree. {reason}", row.frequencies, off.join(", "));
            main.leaf("p", &[("class", "note calm")], text);
        }
    }
    main.leaf(
        "h3",
        &[],
        "Figure 7: posterior densities with one to five frequencies",
    );
    let table_3 = paper::prior(paper::TABLE_3_DENSITY);
    for i in 0..INFERRED.len() {
        let mut curves = vec![(
            "prior".to_owned(),
            "c7",
            Grid::of(&table_3.priors()[i]).prior(&table_3.priors()[i]),
        )];
        for (row, colour) in part.rows.iter().zip(COLOURS) {
            let name = format!("nf = {}", row.frequencies);
            curves.push((name, colour, row.quantities[i].density.clone()));
        }
        let id = format!("{key}-f7-{i}");
        figure(
            main,
            densities(&table_3, i, &curves, Some(paper::TRUTH[i]), &id),
            "",
        );
    }
    main.leaf("h3", &[], "Figure 8: posterior mean over truth, and BMAPE");
    figure(
        main,
        figure_8(part, true),
        "Lines: ours. Dots: the paper's Table 3.",
    );
    figure(main, figure_8(part, false), "");
    predictive(main, part);
}

fn table_2(main: &mut Markup, setting: Setting, column: &Column) {
    let comparisons = column.comparisons(setting);
    let rows: Vec<Vec<Cell>> = comparisons
        .iter()
        .map(|comparison| {
            let mut cells = compared(comparison);
            cells.insert(1, Cell::Text(comparison.statistic.to_owned()));
            cells
        })
        .collect();
    let caption = format!("{}, {} runs.", column.which.name(), column.runs.len());
    rod::table(
        main,
        &caption,
        &["Quantity", "Statistic", "Paper", "Ours", "Difference"],
        &rows,
    );
    if column.which.printed().is_some() {
        main.leaf(
            "p",
            &[("class", "note calm")],
            sentence(setting, column, &comparisons),
        );
    }
}

/// Which figures of a column disagree, in a sentence.
fn sentence(setting: Setting, column: &Column, comparisons: &[Comparison]) -> String {
    let off: Vec<String> = comparisons
        .iter()
        .filter(|c| c.disagrees() == Some(true))
        .map(|c| format!("{} of {}", c.statistic, quantity(&c.quantity).0))
        .collect();
    if off.is_empty() {
        return "Every printed figure of this column agrees with ours.".to_owned();
    }
    let reason = likeliest_reason(setting, column.which.sampler);
    format!("Disagree: {}. {reason}", off.join(", "))
}

/// Cells: quantity with unit, the paper's figure, ours with its error, the difference.
fn compared(comparison: &Comparison) -> Vec<Cell> {
    let (name, unit, factor) = quantity(&comparison.quantity);
    let is_mean = comparison.statistic == "mean";
    let (unit, factor) = if is_mean { (unit, factor) } else { ("", 1.0) };
    let name = if unit.is_empty() {
        name.to_owned()
    } else {
        format!("{name} [{unit}]")
    };
    let paper = comparison.paper.map_or_else(
        || "\u{2013}".to_owned(),
        |printed| significant4(printed.value * factor),
    );
    let difference = match comparison.deviation {
        Some(deviation) => Cell::Line(minus(&format!("{deviation:.1}"))),
        None => Cell::Text("\u{2013}".to_owned()),
    };
    vec![
        Cell::Text(name),
        Cell::Line(paper),
        Cell::Line(with_error(&comparison.ours, factor)),
        difference,
    ]
}

fn with_error(estimate: &Estimate, factor: f64) -> String {
    let (value, error) = (estimate.value * factor, estimate.error * factor);
    if error > 0.0 {
        let decimals = (1.0 - error.log10().floor()).clamp(0.0, 8.0) as usize;
        minus(&format!("{value:.decimals$} \u{b1} {error:.decimals$}"))
    } else {
        significant4(value)
    }
}

/// About four significant digits.
fn significant4(value: f64) -> String {
    let digits = if value == 0.0 {
        0.0
    } else {
        value.abs().log10().floor()
    };
    let decimals = (3.0 - digits).clamp(0.0, 8.0) as usize;
    minus(&format!("{value:.decimals$}"))
}

/// Hyphens before digits as minus signs.
fn minus_signs(text: &str) -> String {
    let mut out = String::new();
    let mut before = ' ';
    let mut rest = text.chars().peekable();
    while let Some(c) = rest.next() {
        let sign = c == '-' && matches!(before, ' ' | 'e') && rest.peek().is_some_and(char::is_ascii_digit);
        out.push(if sign { '\u{2212}' } else { c });
        before = c;
    }
    out
}

fn figure(main: &mut Markup, svg: Markup, caption: &str) {
    main.element("figure", &[], |figure| {
        figure.element("div", &[("class", "scroll"), ("tabindex", "0")], |div| {
            div.append(svg)
        });
        if !caption.is_empty() {
            figure.leaf("figcaption", &[], caption);
        }
    });
}

/// Densities of inferred quantity `i`: name, colour, values on the grid of its prior.
fn densities(
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

fn traces(main: &mut Markup, part: &Part) {
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

fn case_figure(part: &Part, which: usize, name: &str) -> Markup {
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

fn figure_8(part: &Part, ratio: bool) -> Markup {
    let value = |row: &crate::study::table3::Row, i: usize| {
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

fn predictive(main: &mut Markup, part: &Part) {
    main.leaf("h3", &[], "Posterior predictive checks");
    let observed = paper::OBSERVED_HZ[2] / paper::OBSERVED_HZ[0];
    let top = part
        .checks
        .iter()
        .flat_map(|check| check.histogram.iter().copied());
    let top = top.fold(1.0, f64::max);
    let mut drawing = Figure::new(RATIO, (0.0, 1.1 * top), 170.0);
    drawing.x_axis(&axis::numbers(RATIO, 10), "predicted f3 / f1");
    drawing.y_axis(&[], "probability density");
    for (check, class) in part.checks.iter().zip(COLOURS) {
        let width = (RATIO.1 - RATIO.0) / BINS as f64;
        let bins = check.histogram.iter().enumerate();
        drawing.line(class, bins.map(|(i, d)| (RATIO.0 + (i as f64 + 0.5) * width, *d)));
        drawing.key(class, &check.column);
    }
    drawing.event("alarm", observed, "observed");
    drawing.event("over", 3.0, "least of any beam");
    let id = format!("{}-predictive", part.setting.key());
    let title = "Predicted ratio of the third to the first frequency";
    figure(
        main,
        drawing.finish(&id, title, "What the posteriors predict, and what was observed."),
        "A tensioned beam on rotational springs has f3/f1 of at least 3, as a string has. Nothing the model can draw reaches the \
         observed 2.950 but by measurement error; a posterior that looks ordinary hides that.",
    );
    let rows: Vec<Vec<Cell>> = part
        .checks
        .iter()
        .map(|check| {
            vec![
                Cell::Text(check.column.clone()),
                Cell::Line(significant4(check.smallest_ratio)),
                Cell::Line(format!(
                    "{:.3} [{:.3} to {:.3}]",
                    check.ratio[1], check.ratio[0], check.ratio[2]
                )),
                Cell::Line(format!("{:.4}", check.ratio_tail)),
                Cell::Line(format!("{:.4}", check.p_value)),
                Cell::Line(check.residual_hz.map(|r| format!("{r:.3}")).join(", ")),
            ]
        })
        .collect();
    let header = [
        "Posterior",
        "Smallest f3/f1 of the model",
        "Predicted f3/f1",
        "Share as small as observed",
        "Predictive p-value",
        "RMS residuals of modes 1 to 3 [Hz]",
    ];
    rod::table(main, "Observed f3/f1: 2.950.", &header, &rows);
}

fn sensitivity(main: &mut Markup, study: &Study) {
    main.leaf("h2", &[], "Sensitivity");
    let rows: Vec<Vec<Cell>> = study
        .sensitivity
        .iter()
        .map(|s| {
            vec![
                Cell::Text(s.order.to_string()),
                Cell::Text(quantity(s.quantity.key()).0.to_owned()),
                Cell::Line(format!("{:.4}", s.first)),
                Cell::Line(with_error(&s.first_monte_carlo, 1.0)),
                Cell::Line(format!("{:.4}", s.total)),
                Cell::Line(with_error(&s.total_monte_carlo, 1.0)),
            ]
        })
        .collect();
    let header = [
        "Mode",
        "Quantity",
        "First order, chaos",
        "First order, Monte Carlo",
        "Total, chaos",
        "Total, Monte Carlo",
    ];
    let caption = "Sobol's indices under Table 1's prior: from the chaos's coefficients, and by Saltelli's estimate on the exact model.";
    rod::table(main, caption, &header, &rows);
    main.leaf(
        "h3",
        &[],
        "Figure 4: frequencies over the stiffness of the springs",
    );
    let springs = &study.springs;
    let logs: Vec<f64> = springs.stiffness_n_m.iter().map(|k| 10.0 * k.log10()).collect();
    let x = axis::span(logs.iter().copied(), 0.0).unwrap_or((0.0, 1.0));
    let all = springs.frequency_hz.iter().flatten().copied();
    let y = axis::span(all, 0.08).unwrap_or((0.0, 1.0));
    let mut drawing = Figure::new(x, y, 190.0);
    drawing.x_axis(&axis::powers(x, 8), "stiffness of either spring [N m/rad]");
    drawing.y_axis(&axis::numbers(y, 6), "frequency [Hz]");
    for (mode, class) in COLOURS.iter().take(3).enumerate() {
        let points = logs.iter().zip(&springs.frequency_hz).map(|(k, f)| (*k, f[mode]));
        drawing.line(class, points);
        drawing.key(class, &format!("mode {}", mode + 1));
    }
    drawing.event("over", 10.0 * 4e5f64.log10(), "prior mean");
    let title = "Frequencies over the stiffness of the springs";
    let change: Vec<String> = (0..3)
        .map(|i| {
            format!(
                "{:.1} %",
                100.0 * (springs.clamped_hz[i] / springs.hinged_hz[i] - 1.0)
            )
        })
        .collect();
    let caption = format!(
        "From hinges to clamps modes 1 to 3 rise by {}.",
        change.join(", ")
    );
    figure(
        main,
        drawing.finish("f4", title, "First three modes from hinges to clamps."),
        &caption,
    );
}

fn emulators(main: &mut Markup, study: &Study) {
    main.leaf("h2", &[], "Emulators");
    let mut rows: Vec<Vec<Cell>> = Vec::new();
    for report in &study.emulators {
        for mode in report.modes.iter().take(3) {
            let variance = report.grid.iter().flatten().find(|grid| grid.order == mode.order);
            let shown = |value: f64| Cell::Line(minus(&format!("{value:.1e}")));
            rows.push(vec![
                Cell::Text(report.emulator.clone()),
                Cell::Text(mode.order.to_string()),
                shown(mode.value_hz.rms),
                shown(mode.value_hz.q999),
                shown(mode.value_hz.max),
                mode.slope
                    .map_or(Cell::Text("\u{2013}".to_owned()), |slope| shown(slope.rms)),
                variance.map_or(Cell::Text("\u{2013}".to_owned()), |grid| shown(grid.variance_hz2)),
            ]);
        }
    }
    let header = [
        "Emulator",
        "Mode",
        "RMS error [Hz]",
        "99.9 % [Hz]",
        "Largest [Hz]",
        "RMS error of the slope",
        "Variance on the design [Hz\u{b2}]",
    ];
    let caption = "Against the exact model on 20 000 draws of Table 1's prior; those outside an emulator's design, where the exact model answers, left out. The slope is d ln f / d ln N. Paper: variances below 1.364e-5 Hz\u{b2}, largest errors 5e-3, 5e-2, 4e-2 Hz.";
    rod::table(main, caption, &header, &rows);
}

fn beyond(main: &mut Markup, study: &Study) {
    main.leaf("h2", &[], "Beyond the paper");
    main.leaf("h3", &[], "The same record under other assumptions");
    let rows: Vec<Vec<Cell>> = study
        .assumptions
        .iter()
        .map(|a| {
            vec![
                Cell::Text(a.name()),
                Cell::Line(significant(a.conflict)),
                Cell::Line(with_error(&a.mean[0], 1e-3)),
                Cell::Line(with_error(&a.cv[0], 1.0)),
                Cell::Line(with_error(&a.mean[1], 1e-9)),
                Cell::Line(with_error(&a.abc_force_n, 1e-3)),
                Cell::Line(with_error(&a.abc_force_cv, 1.0)),
            ]
        })
        .collect();
    let header = [
        "Assumption",
        "Conflict [sd]",
        "N, MCMC [kN]",
        "CV of N, MCMC",
        "E, MCMC [GPa]",
        "N, ABC [kN]",
        "CV of N, ABC",
    ];
    let caption = "Conflict: how far the record lies from every beam. Only room for a wrong model (1 to 3 % a mode) or for a wrong record (1 Hz) lets the data be what they are. ABC: this program's, regression-adjusted where the record is within reach of the draws.";
    rod::table(main, caption, &header, &rows);
    main.leaf("h3", &[], "What to measure next");
    let rows: Vec<Vec<Cell>> = study
        .worth
        .iter()
        .map(|w| {
            vec![
                Cell::Text(w.measured.to_owned()),
                Cell::Line(format!("{:.2}", 100.0 * w.cv.value)),
                Cell::Line(format!(
                    "{:.3} \u{b1} {:.3}",
                    w.of_first.value,
                    w.of_first.error_of_mean()
                )),
            ]
        })
        .collect();
    let caption = format!(
        "Expected uncertainty of the axial force over {} rods drawn from Table 1's prior, and what is left of the first row's.",
        study.effort.rods
    );
    let header = ["Measured", "CV of N [%]", "Of the first row's"];
    rod::table(main, &caption, &header, &rows);
    main.leaf("h3", &[], "The ladder of samplers");
    let rows: Vec<Vec<Cell>> = study
        .ladder
        .iter()
        .map(|rung| {
            vec![
                Cell::Text(rung.sampler.to_owned()),
                Cell::Line(with_error(&rung.mean_n, 1e-3)),
                Cell::Line(with_error(&rung.sd_n, 1e-3)),
                Cell::Line(minus(&format!("{:.3}", rung.off))),
                Cell::Line(format!("{:.3}", rung.sd_ratio)),
            ]
        })
        .collect();
    let header = [
        "Sampler",
        "N [kN]",
        "sd of N [kN]",
        "Mean off [sd]",
        "sd over exact",
    ];
    let caption = "A record that the model can produce (the rod at the prior means, errors of 31.6 mHz): each sampler against the exact posterior.";
    rod::table(main, caption, &header, &rows);
}

fn provenance(footer: &mut Markup, study: &Study) {
    footer.leaf("h2", &[], "Where these numbers come from");
    footer.element("dl", &[], |list| {
        let effort = &study.effort;
        let mut entry = |name: &str, value: String| {
            list.leaf("dt", &[], name);
            list.leaf("dd", &[], value);
        };
        entry("program", format!("tirante {}", env!("CARGO_PKG_VERSION")));
        entry("seed", study.seed.to_string());
        entry(
            "runs of every ABC, MCMC",
            format!("{}, {}", effort.abc_runs, effort.mcmc_runs),
        );
        entry(
            "draws of ABC, of many",
            format!("{}, {}", effort.abc_draws, effort.many_draws),
        );
        entry("steps of MCMC", format!("{} by 16 chains", effort.mcmc_steps));
        let samplers = [Sampler::Mcmc, Sampler::Abc, Sampler::AbcOfMany];
        let models = study
            .parts
            .first()
            .map_or(0, |part| part.columns.len() / samplers.len());
        entry("forward models", models.to_string());
    });
}
