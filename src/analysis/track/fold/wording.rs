//! Sentences of drifts, notices and patterns.

use crate::signal::record::Timestamp;
use crate::track::alarm::change::Change;
use crate::track::alternatives::Explained;
use crate::track::drift::watch::Witness;
use crate::track::relative::Interval;

/// Standard deviations from zero below which a size has no direction.
const SIGNED_SD: f64 = 0.5;

/// One sentence about a drift: as a fact where the modes leave no other kind of change, as one of several explanations where they do.
pub(super) fn drift_message(change: &Change, witness: Witness, alternatives: Option<&Explained>) -> String {
    let at = match witness {
        Witness::Peers | Witness::Blind => "",
        _ => " at the reference temperature",
    };
    let who = match witness {
        Witness::Confirmed => "; the other rods confirm that it is this rod",
        Witness::Unconfirmed => "; the other rods do not confirm it yet",
        Witness::Alone => "; no other rods bear witness: a thermometer that drifts looks the same",
        Witness::Peers => "; there is no temperature, the other rods of the site stand in for it",
        Witness::Blind => {
            "; it was compared with neither a temperature nor the other rods: a sudden change of weather may look the same"
        }
    };
    let (as_if, explained) = match alternatives {
        None => ("", String::new()),
        Some(known) if known.is_axial() == Some(true) => ("", format!("; {}", known.certainty())),
        Some(open) => ("the frequencies changed as if ", format!("; {}", open.rivals())),
    };
    let (went, since) = (sized(&change.size), date(change.onset));
    format!("{as_if}the axial force{at} {went} since about {since}{who}{explained}")
}

/// A size in words, counted in the direction it went; below zero it may have gone the other way.
pub(super) fn sized(size: &Interval) -> String {
    let toward = |fraction: f64| 100.0 * fraction * size.mean.signum();
    let (one, other) = (toward(size.q025), toward(size.q975));
    let (low, high) = (one.min(other), one.max(other));
    if size.mean.abs() < SIGNED_SD * size.sd {
        return format!("changed by an amount that is not known yet (95 %: {low:.0} to {high:+.0} %)");
    }
    let verb = if size.mean < 0.0 { "fell" } else { "rose" };
    format!(
        "{verb} by {:.2} % (95 %: {low:.2} to {high:.2} %)",
        toward(size.mean)
    )
}

/// `is_loss`: the frequencies themselves show a sudden loss beyond the limit.
pub(super) fn common_message(change: &Change, moving: usize, others: usize, is_loss: bool) -> String {
    let causes = if is_loss {
        "the whole structure, since the frequencies themselves fell at once, which no thermometer and no weather explains"
    } else {
        "the thermometer, the weather, or the whole structure; no rod differs from the others"
    };
    format!(
        "{} of {} rods moved together since about {}: {causes}",
        moving + 1,
        others + 1,
        date(change.onset)
    )
}

pub(super) fn not_axial_message(p: f64) -> String {
    format!(
        "the natural frequencies changed in a way no change of axial force explains (p = {p:.1e}): added mass, a support, or \
         mistaken modes"
    )
}

/// A probability in words or percent.
pub(super) fn probable(probability: f64) -> String {
    if probability > 0.999 {
        "probability > 99.9 %".to_owned()
    } else {
        format!("probability {:.1} %", 100.0 * probability)
    }
}

fn date(time: Timestamp) -> String {
    time.to_string().chars().take(10).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_without_a_direction_neither_rose_nor_fell() {
        let size = |mean, sd: f64| {
            sized(&Interval {
                mean,
                sd,
                q025: mean - 1.96 * sd,
                q975: mean + 1.96 * sd,
            })
        };
        assert_eq!(size(-0.03, 0.005), "fell by 3.00 % (95 %: 2.02 to 3.98 %)");
        assert_eq!(size(0.03, 0.02), "rose by 3.00 % (95 %: -0.92 to 6.92 %)");
        let unknown = "changed by an amount that is not known yet (95 %: -24 to +24 %)";
        assert_eq!(size(0.0, 0.12), unknown);
        assert_eq!(size(-1e-4, 0.12), unknown);
    }
}
