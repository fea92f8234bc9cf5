//! Reasons why printed figures disagree with ours: one sentence each, with the extent of the check.

use super::paper::INFERRED;
use super::setting::Setting;
use super::table2::{Column, Sampler};

/// Reason why Table 3 may disagree, with one frequency and with more.
pub fn of_table_3(frequencies: usize) -> &'static str {
    if frequencies == 1 {
        "Likeliest reason: that row was run on other data, perhaps the real record: its means give a first frequency near that record's, 13 % below the true rod's."
    } else {
        "Likeliest reason: the share accepted, which the paper does not say for this table."
    }
}

/// Reason why a column of Table 2 may disagree.
pub fn of_table_2(setting: Setting, column: &Column) -> String {
    match (setting, column.which.sampler) {
        (Setting::AsPrinted, Sampler::Mcmc) => {
            "Likeliest reason: the likelihood that was run had a larger error than the one printed. With a variance of 1e-3 Hz\u{b2} the record, which no beam of the model can produce, drives E to zero.".to_owned()
        }
        (Setting::AsPrinted, _) => {
            "Likeliest reason: more draws were accepted than alpha = 0.01 allows, and the density prior was Table 3's; with 5 % and 7000 kg/m\u{b3} the column comes out. E falls as the tolerance shrinks, since the data ask for a string.".to_owned()
        }
        (Setting::AsInferred, Sampler::Mcmc) => format!(
            "The reason is not known. No error variance gives this column under either density prior (see \"Beyond the paper\"). Were it chance, the paper's chain would have been worth {} independent draws; whether it was cannot be told from what is printed.",
            independent_draws(column).map_or_else(|| "few".to_owned(), |n| format!("about {n:.0}"))
        ),
        (Setting::AsInferred, _) => "The reason is not known.".to_owned(),
    }
}

/// Number of independent draws from our posterior of which the printed means would be typical, each quantity
/// by itself.
fn independent_draws(column: &Column) -> Option<f64> {
    let printed = column.which.printed()?;
    let square = |i: usize| {
        let (mean, cv) = (
            column.estimate(|run| run.mean[i]),
            column.estimate(|run| run.cv[i]),
        );
        ((printed.mean[i].value / mean.value - 1.0) / cv.value).powi(2)
    };
    let squares: f64 = (0..INFERRED.len()).map(square).sum();
    Some(INFERRED.len() as f64 / squares).filter(|n| n.is_finite())
}
