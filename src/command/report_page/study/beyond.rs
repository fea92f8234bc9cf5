//! The study's page beyond the paper's tables: sensitivity, emulators, other assumptions, worth of further
//! measurements.

use super::figures::COLOURS;
use super::with_error;
use crate::analysis::lab::study::Study;
use crate::analysis::lab::study::estimate::Estimate;
use crate::command::report_page::axis::{self, minus};
use crate::command::report_page::distribution::{quantity, significant};
use crate::command::report_page::figure::{Figure, figure};
use crate::command::report_page::markup::Markup;
use crate::command::report_page::table::{Cell, table};

pub(super) fn sensitivity(main: &mut Markup, study: &Study) {
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
    table(main, caption, &header, &rows);
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

pub(super) fn emulators(main: &mut Markup, study: &Study) {
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
    table(main, caption, &header, &rows);
    times(main, study);
}

fn times(main: &mut Markup, study: &Study) {
    if study.times.is_empty() {
        main.leaf(
            "p",
            &[("class", "about")],
            "What training, evaluation and sampling cost: tirante study --times measures it on this machine. It is left out \
             here because it is not the same twice.",
        );
        return;
    }
    let rows: Vec<Vec<Cell>> = study
        .times
        .iter()
        .map(|time| {
            vec![
                Cell::Text(time.what.to_owned()),
                Cell::Text(time.model.to_owned()),
                Cell::Line(duration(time.seconds)),
            ]
        })
        .collect();
    let caption = format!(
        "Times on one thread of the machine that made this page; the only figures here that are not the same twice. Chaos and \
         perceptron learn from the same {} solves. Paper: 5 minutes for one ABC of {} draws, 2 hours for one MCMC of {} steps.",
        6usize.pow(6),
        study.effort.abc_draws,
        study.effort.mcmc_steps
    );
    table(main, &caption, &["What", "Model", "Time"], &rows);
}

/// A time with its unit.
fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 1e-3 => format!("{} \u{b5}s", significant(1e6 * s)),
        s if s < 1.0 => format!("{} ms", significant(1e3 * s)),
        s => format!("{} s", significant(s)),
    }
}

pub(super) fn beyond(main: &mut Markup, study: &Study) {
    main.leaf("h2", &[], "Beyond the paper");
    main.leaf("h3", &[], "The same record under other assumptions");
    let rows: Vec<Vec<Cell>> = study
        .assumptions
        .iter()
        .map(|a| {
            vec![
                Cell::Line(format!("{:.0}", a.density_kg_m3)),
                Cell::Line(significant(a.error_sd_hz)),
                Cell::Line(format!("{:.0} %", 100.0 * a.discrepancy)),
                Cell::Line(significant(a.conflict)),
                both(&a.mean[0], &a.cv[0], 1e-3),
                both(&a.mean[1], &a.cv[1], 1e-9),
                both(&a.mean[2], &a.cv[2], 1.0),
                both(&a.mean[3], &a.cv[3], 1.0),
                both(&a.abc_force_n, &a.abc_force_cv, 1e-3),
            ]
        })
        .collect();
    let header = [
        "Density prior [kg/m\u{b3}]",
        "Error [Hz]",
        "Discrepancy",
        "Conflict [sd]",
        "N [kN]",
        "E [GPa]",
        "Density [kg/m\u{b3}]",
        "Side [m]",
        "N by ABC [kN]",
    ];
    let caption = "Posterior means by MCMC on the reduced emulator, in brackets the coefficients of variation. Conflict: how far the record lies from every beam; only room for a wrong model (1 to 3 % a mode) or for a wrong record (1 Hz) lets the data be what they are. ABC: this program's, regression-adjusted where the record is within reach of the draws. The paper's MCMC columns: 605 (0.168), 158 (0.318), 7520 (0.096), 0.076 (0.074), and on the chaos 573 (0.206), 153 (0.349), 7299 (0.086), 0.074 (0.087).";
    table(main, caption, &header, &rows);
    main.leaf("h3", &[], "What to measure next");
    let rows: Vec<Vec<Cell>> = study
        .worth
        .iter()
        .map(|w| {
            vec![
                Cell::Text(w.measured.to_owned()),
                Cell::Line(match w.cv.runs {
                    0 => "-".to_owned(),
                    _ => format!("{:.2}", 100.0 * w.cv.value),
                }),
                Cell::Line(match w.of_first.runs {
                    0 => "-".to_owned(),
                    1 => format!("{:.3}", w.of_first.value),
                    _ => format!("{:.3} \u{b1} {:.3}", w.of_first.value, w.of_first.error_of_mean()),
                }),
                Cell::Line(w.of_first.runs.to_string()),
            ]
        })
        .collect();
    let caption = format!(
        "Expected uncertainty of the axial force over {} rods drawn from Table 1's prior, and what is left of the first row's, over the rods of which the sampler can give both.",
        study.effort.rods
    );
    let header = ["Measured", "CV of N [%]", "Of the first row's", "Rods"];
    table(main, &caption, &header, &rows);
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
    table(main, caption, &header, &rows);
}

/// Mean and, in brackets, coefficient of variation.
fn both(mean: &Estimate, cv: &Estimate, factor: f64) -> Cell {
    let (value, error) = (factor * mean.value, factor * mean.error);
    let decimals = (-error.log10().floor()).clamp(0.0, 5.0) as usize;
    Cell::Line(format!("{value:.decimals$} ({:.3})", cv.value))
}
