//! The paper's study as a page: verdicts on its statements, then every table and figure beside ours.

mod beyond;
mod figures;

use super::axis::{self, minus};
use super::distribution::quantity;
use super::figure::{Figure, figure};
use super::markup::Markup;
use super::page::document;
use super::table::{Cell, table};
use crate::analysis::lab::study::density::Grid;
use crate::analysis::lab::study::estimate::{CLOSE, Comparison, DISAGREE, Estimate};
use crate::analysis::lab::study::paper::{self, INFERRED};
use crate::analysis::lab::study::predictive::{BINS, RATIO};
use crate::analysis::lab::study::setting::Setting;
use crate::analysis::lab::study::table2::{Column, Sampler};
use crate::analysis::lab::study::verdict::Verdict;
use crate::analysis::lab::study::{Part, Study, reasons};
use beyond::{beyond, emulators, sensitivity};
use figures::{COLOURS, case_figure, densities, figure_8, traces};

/// The page of a study. The same study gives the same bytes.
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
    let shown = |(agree, all): &(usize, usize)| {
        let text = format!("{agree} of {all}");
        Cell::State(if agree == all { "monitoring" } else { "alarm-state" }, text)
    };
    let rows: Vec<Vec<Cell>> = study
        .score()
        .iter()
        .map(|score| {
            let mut cells = vec![Cell::Text(score.name.clone())];
            cells.extend(score.agree.iter().map(shown));
            cells
        })
        .collect();
    let mut header = vec!["Column or row of the paper"];
    header.extend(study.parts.iter().map(|part| part.setting.key()));
    let caption = format!("Printed figures within {DISAGREE} standard errors of ours.");
    table(main, &caption, &header, &rows);
    for part in &study.parts {
        let text = format!("{}: {}.", part.setting.key(), part.setting.about());
        main.leaf("p", &[("class", "about")], text);
    }
    let rows: Vec<Vec<Cell>> = study
        .claims
        .iter()
        .map(|claim| {
            let class = match claim.verdict {
                Verdict::Holds => "monitoring",
                Verdict::Fails => "alarm-state",
                Verdict::Open => "learning",
            };
            vec![
                Cell::Text(claim.statement.clone()),
                Cell::Text(claim.source.to_owned()),
                Cell::State(class, claim.verdict.words().to_owned()),
                Cell::Text(minus_signs(&claim.evidence)),
            ]
        })
        .collect();
    let caption = format!(
        "Statements of the paper, and of earlier checks of it, judged by the figures below. Three rules: a printed figure comes out \
         within {DISAGREE} standard errors of one run; it is about or close to ours within {:.0} % or where ours rounds to it; one \
         figure is larger than another by {DISAGREE} standard errors of our means, and within them the statement is open.",
        100.0 * CLOSE
    );
    table(
        main,
        &caption,
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
        let all = crate::analysis::lab::study::table3::comparisons(row, part.setting);
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
    table(
        main,
        "Posterior means with the first one to five frequencies.",
        &header,
        &rows,
    );
    for row in &part.rows {
        let all = crate::analysis::lab::study::table3::comparisons(row, part.setting);
        let off: Vec<&str> = all
            .iter()
            .filter(|c| c.disagrees() == Some(true))
            .map(|c| quantity(&c.quantity).0)
            .collect();
        if !off.is_empty() {
            let reason = reasons::of_table_3(row.frequencies);
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
    table(
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

/// Sentence with the figures of a column that disagree.
fn sentence(setting: Setting, column: &Column, comparisons: &[Comparison]) -> String {
    let off: Vec<String> = comparisons
        .iter()
        .filter(|c| c.disagrees() == Some(true))
        .map(|c| format!("{} of {}", c.statistic, quantity(&c.quantity).0))
        .collect();
    if off.is_empty() {
        return "Every printed figure of this column agrees with ours.".to_owned();
    }
    let reason = reasons::of_table_2(setting, column);
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

/// Replaces hyphens before digits by minus signs.
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
                    check.ratio[1].value, check.ratio[0].value, check.ratio[2].value
                )),
                Cell::Line(with_error(&check.ratio_tail, 1.0)),
                Cell::Line(minus(&format!("{:.1e}", check.p_value.value))),
                Cell::Line(check.residual_hz.map(|r| format!("{:.3}", r.value)).join(", ")),
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
    table(main, "Observed f3/f1: 2.950.", &header, &rows);
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
