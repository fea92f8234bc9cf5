//! Results of one record beyond its force: priors against posteriors, and the sources of the force's variance.

use super::distribution::{self, significant};
use super::figure::figure;
use super::markup::Markup;
use super::page::moment;
use super::table::{Cell, table};
use super::view::RodReport;
use crate::analysis::inference::VarianceShares;
use crate::analysis::record_view::Snapshot;

/// Priors and posteriors of the quantities, and the sources of the force's variance.
pub(super) fn section(html: &mut Markup, rod: &RodReport, latest: &Snapshot, id: &str) {
    if latest.densities.is_empty() {
        return;
    }
    html.leaf("h3", &[], "What the record taught");
    html.leaf(
        "p",
        &[("class", "about")],
        "What was assumed of each quantity (grey) and what the latest record leaves possible (blue). A blue curve narrower than the \
         grey one was learned from the vibration; one that covers it was not.",
    );
    html.element("div", &[("class", "pair many")], |pair| {
        for (i, density) in latest.densities.iter().enumerate() {
            figure(
                pair,
                Some(distribution::density(
                    rod,
                    density,
                    distribution::HIGH,
                    &format!("{id}-den{i}"),
                )),
                "",
            );
        }
    });
    let rows: Vec<Vec<Cell>> = latest
        .densities
        .iter()
        .map(|density| {
            let (name, unit, factor) = distribution::quantity(&density.quantity);
            let shown =
                |(mean, sd): (f64, f64)| Cell::Text(distribution::mean_and_sd(mean * factor, sd * factor));
            vec![
                Cell::Text(format!("{name} [{unit}]")),
                shown(density.prior_mean_sd),
                shown(density.posterior_mean_sd),
            ]
        })
        .collect();
    let caption = format!(
        "Mean \u{b1} standard deviation, record of {}, {:.0} s at {} Hz, seed {}.",
        moment(latest.start),
        latest.duration_s,
        significant(latest.fs_hz),
        latest.seed
    );
    table(
        html,
        &caption,
        &["Quantity", "Before (prior)", "After (posterior)"],
        &rows,
    );
    if let Some(shares) = &latest.hangs_on {
        hangs_on(html, shares);
    }
}

/// Sentences on the sources of the force's variance, and their table.
fn hangs_on(html: &mut Markup, shares: &VarianceShares) {
    html.leaf("h3", &[], "What the force hangs on");
    sentences(html, shares);
    sources(
        html,
        shares,
        "Shares of the variance of the absolute force; they add up to all of it. The last column is the part that would vanish if this source were known exactly: sources \
         that the frequencies tie together overlap there.",
    );
}

/// Sentences on the sources of the force's variance.
pub(super) fn sentences(html: &mut Markup, shares: &VarianceShares) {
    for sentence in &shares.said {
        html.leaf("p", &[("class", "about")], format!("{sentence}."));
    }
}

/// Table of the sources of the force's variance.
pub(super) fn sources(html: &mut Markup, shares: &VarianceShares, caption: &str) {
    let percent = |share: f64| Cell::Line(format!("{:.0} %", 100.0 * share));
    let rows: Vec<Vec<Cell>> = shares
        .sources
        .iter()
        .map(|part| {
            vec![
                Cell::Text(part.source.name().to_owned()),
                percent(part.share),
                percent(part.if_known),
            ]
        })
        .collect();
    table(html, caption, &["Source", "Share", "Less if known"], &rows);
}
