//! Rates, coverage and delays of a world's simulated sites.

use super::{Args, TrueChange};
use crate::analysis::lab::synthesis::{Outcome, Raised};
use crate::analysis::track::{Kind, Witness};
use serde::Serialize;
use statrs::function::beta::beta_reg;
use std::fmt::Write as _;

/// A share with its exact 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Share {
    count: usize,
    all: usize,
    rate: Option<f64>,
    q025: f64,
    q975: f64,
}

impl Share {
    fn new(count: usize, all: usize) -> Self {
        let (q025, q975) = clopper_pearson(count, all);
        Self {
            count,
            all,
            rate: (all > 0).then(|| count as f64 / all as f64),
            q025,
            q975,
        }
    }

    fn text(&self) -> String {
        let percent = |x: f64| 100.0 * x;
        match self.rate {
            Some(rate) => format!(
                "{:>5} of {:<6} {:>5.1} % ({:.1} to {:.1})",
                self.count,
                self.all,
                percent(rate),
                percent(self.q025),
                percent(self.q975)
            ),
            None => String::from("    -"),
        }
    }
}

/// Figures printed for a world.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Proof {
    world: String,
    sites: usize,
    rods: usize,
    days: usize,
    learned_periods: usize,
    frequency_sd: f64,
    seed: u64,
    change: Option<TrueChange>,
    /// Number of rods that were never tracked; they count as without an alarm.
    never_monitored: usize,
    /// Number of draws that would have come near to slack.
    redrawn: u64,
    /// Largest probability of a false drift alarm in the time tracked, as stated.
    stated: f64,
    /// Rates of false alarms by kind: at all, or before the change.
    alarms: Vec<Rate>,
    /// Share of rods with a false drift that the other rods confirmed.
    confirmed: Share,
    /// Share of sites with at least one notice that rods moved together.
    notices: Share,
    /// Share of records whose 95 % interval of the change since the baseline held the truth.
    coverage: Share,
    found: Option<Found>,
}

/// Rate of false alarms of one kind.
#[derive(Debug, Clone, Serialize)]
struct Rate {
    kind: Kind,
    #[serde(flatten)]
    share: Share,
}

/// Detection of a true change.
#[derive(Debug, Clone, Serialize)]
struct Found {
    /// Number of sites whose first rod had no lasting alarm before the change.
    followed: usize,
    drift: usize,
    confirmed: usize,
    not_axial: usize,
    /// Days from the change to the record that raised the drift alarm.
    q10_d: Option<f64>,
    median_d: Option<f64>,
    q90_d: Option<f64>,
    /// Shares of intervals of size and onset, at the first alarm, that held the truth.
    size: Share,
    onset: Share,
}

impl Proof {
    pub fn new(
        args: &Args,
        world: &str,
        learned: usize,
        days: usize,
        stated: f64,
        sites: &[Vec<Outcome>],
    ) -> Self {
        // Only the first rod of a site changes.
        let begin = |place: usize| {
            args.change
                .filter(|_| place == 0)
                .map_or(f64::INFINITY, |change| change.start_d)
        };
        let rods = || sites.iter().flat_map(|site| site.iter().enumerate());
        let all = rods().count();
        let count = |is_it: &dyn Fn(&Raised) -> bool| {
            let falsely = |(place, outcome): &(usize, &Outcome)| {
                outcome
                    .raised
                    .iter()
                    .any(|raised| is_it(raised) && raised.day < begin(*place))
            };
            rods().filter(falsely).count()
        };
        let is_confirmed =
            |raised: &Raised| raised.kind == Kind::Drift && raised.witness == Some(Witness::Confirmed);
        let told_together = |site: &&Vec<Outcome>| {
            let mut raised = site.iter().flat_map(|outcome| &outcome.raised);
            raised.any(|raised| raised.kind == Kind::Common)
        };
        let told = rods().fold([0, 0], |sum, (_, outcome)| {
            [sum[0] + outcome.told[0], sum[1] + outcome.told[1]]
        });
        Self {
            world: world.to_owned(),
            sites: sites.len(),
            rods: all,
            days,
            learned_periods: learned,
            frequency_sd: args.frequency_sd,
            seed: args.seed,
            change: args.change,
            never_monitored: rods().filter(|(_, outcome)| !outcome.monitored).count(),
            redrawn: rods().map(|(_, outcome)| outcome.redrawn).sum(),
            stated,
            alarms: Kind::ALL
                .map(|kind| Rate {
                    kind,
                    share: Share::new(count(&|raised| raised.kind == kind), all),
                })
                .into(),
            confirmed: Share::new(count(&is_confirmed), all),
            notices: Share::new(sites.iter().filter(told_together).count(), sites.len()),
            coverage: Share::new(told[1], told[0]),
            found: args.change.map(|change| Found::new(change, sites)),
        }
    }

    pub fn table(&self) -> Result<String, std::fmt::Error> {
        let mut out = String::new();
        writeln!(
            out,
            "{}: {} rods on {} sites, {} days, {} of them learned; frequencies {} %",
            self.world,
            self.rods,
            self.sites,
            self.days,
            self.learned_periods,
            100.0 * self.frequency_sd,
        )?;
        writeln!(
            out,
            "{} never followed; {} draws would have come near to slack",
            self.never_monitored, self.redrawn
        )?;
        let until = if self.change.is_some() {
            ", before the change"
        } else {
            ""
        };
        writeln!(out, "false alarms, rods{until} (95 % interval)")?;
        for rate in &self.alarms {
            write!(out, "  {:<17} {}", rate.kind, rate.share.text())?;
            if rate.kind == Kind::Drift && self.change.is_none() {
                write!(out, "   stated: at most {:.1} %", 100.0 * self.stated)?;
            }
            writeln!(out)?;
        }
        writeln!(out, "  {:<17} {}", "confirmed drift", self.confirmed.text())?;
        writeln!(out, "sites with notice   {}", self.notices.text())?;
        writeln!(out, "95 % intervals held {}", self.coverage.text())?;
        if let (Some(change), Some(found)) = (self.change, &self.found) {
            let days = |days: Option<f64>| days.map_or("never".to_owned(), |days| format!("{days:.1} d"));
            writeln!(
                out,
                "{} {} %{} on day {}: of {} rods drift told of {}, confirmed {}, not-axial {}; after {} (median), {} (10 %), {} (90 %)",
                if change.is_ramp { "ramp" } else { "step" },
                100.0 * change.relative,
                if change.is_ramp { " a year" } else { "" },
                change.start_d,
                found.followed,
                found.drift,
                found.confirmed,
                found.not_axial,
                days(found.median_d),
                days(found.q10_d),
                days(found.q90_d),
            )?;
            writeln!(out, "  size held         {}", found.size.text())?;
            writeln!(out, "  onset held        {}", found.onset.text())?;
        }
        Ok(out)
    }
}

impl Found {
    fn new(change: TrueChange, sites: &[Vec<Outcome>]) -> Self {
        let is_undisturbed = |outcome: &&Outcome| {
            let mut raised = outcome.raised.iter();
            !raised.any(|raised| raised.kind.is_latched() && raised.day < change.start_d)
        };
        let followed: Vec<&Outcome> = sites
            .iter()
            .filter_map(|site| site.first())
            .filter(is_undisturbed)
            .collect();
        let first = |is_it: fn(&Raised) -> bool| -> Vec<Raised> {
            followed
                .iter()
                .filter_map(|outcome| outcome.raised.iter().find(|raised| is_it(raised)).copied())
                .collect()
        };
        let drifts = first(|raised| raised.kind == Kind::Drift);
        let mut days: Vec<f64> = drifts.iter().map(|raised| raised.day - change.start_d).collect();
        days.sort_by(f64::total_cmp);
        let rank = |p: f64| ((p * followed.len() as f64).ceil() as usize).saturating_sub(1);
        let quantile = |p: f64| days.get(rank(p)).copied();
        let held = |which: usize| {
            let all: Vec<[bool; 2]> = drifts.iter().filter_map(|raised| raised.held).collect();
            Share::new(all.iter().filter(|held| held[which]).count(), all.len())
        };
        Self {
            followed: followed.len(),
            drift: drifts.len(),
            confirmed: drifts
                .iter()
                .filter(|raised| raised.witness == Some(Witness::Confirmed))
                .count(),
            not_axial: first(|raised| raised.kind == Kind::NotAxial).len(),
            q10_d: quantile(0.1),
            median_d: quantile(0.5),
            q90_d: quantile(0.9),
            size: held(0),
            onset: held(1),
        }
    }
}

/// The exact 95 % interval of a probability from `count` of `all` (Clopper and Pearson, 1934).
fn clopper_pearson(count: usize, all: usize) -> (f64, f64) {
    // P(at least count | p) = I_p(count, all - count + 1) is increasing in p.
    let solve = |count: usize, tail: f64| {
        let (a, b) = (count as f64, (all - count + 1) as f64);
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if beta_reg(a, b, middle) < tail {
                low = middle;
            } else {
                high = middle;
            }
        }
        0.5 * (low + high)
    };
    let low = if count == 0 { 0.0 } else { solve(count, 0.025) };
    let high = if count == all {
        1.0
    } else {
        solve(count + 1, 0.975)
    };
    (low, high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_those_of_clopper_and_pearson() {
        // scipy.stats.binomtest(k, n).proportion_ci(method="exact")
        for (count, all, low, high) in [
            (0, 50, 0.0, 0.0711217),
            (17, 200, 0.0502959, 0.1326052),
            (50, 50, 0.9288783, 1.0),
        ] {
            let (own_low, own_high) = clopper_pearson(count, all);
            assert!(
                (own_low - low).abs() < 1e-6 && (own_high - high).abs() < 1e-6,
                "{own_low} {own_high}"
            );
        }
        assert_eq!(Share::new(0, 0).text().trim(), "-");
    }
}
