//! Shiryaev-Roberts detection over onset particles: each is a copy of the null bank in which the force has changed since.
//!
//! Every period, before its ratio is learned, a small step, a large step and, once a week, a ramp are born. With p_0 the
//! predictive density of the null bank and p_k that of particle k,
//!
//! ```text
//! W_k <- W_k p_k(y) / p_0(y),     R = 0.375 sum W_small + 0.25 sum W_large + 0.375 sum W_ramp
//! ```
//!
//! where a step is born with weight 1 and a ramp with the periods since the last. Under the null bank's own predictive law each W_k
//! is a martingale, so R less the number of periods is a supermartingale, for any sizes, onsets and merging. For the first
//! time T with R > A hence E T >= A and P(T <= n) <= n / A (Polunchenko, Sokolov, Du 2013; Shin, Ramdas, Rinaldo 2024).
//! This assumes neither white residuals nor tables.
//!
//! After a change the force may change again: each period the heaviest particle k, where its part of R is above 10^4, leaves a share q of
//! that part to copies of itself of which the change is free anew by a step,
//!
//! ```text
//! W_k <- (1 - q) W_k,     W_copy = q W_k (by shares),     var(c) <- var(c) + size^2
//! ```
//!
//! so that c is the sum of both. R stays as it is, and a supermartingale. Without them a second loss would be nothing to the particles
//! beside the evidence of the first, and those born from the null bank would take the first for weather.

use super::bank::Bank;
use super::block::Workspace;
use super::onset::Onsets;
use super::passage::Passage;
use super::prior::BankPrior;
use super::row::{Law, Row, Seen};
use crate::signal::record::time::YEAR_D;
use serde::{Deserialize, Serialize};

/// Number of periods before the first onset is considered.
const BEFORE: usize = 4;
/// Odds that the force changes year by year since before the first period, against none.
const STANDING_ODDS: f64 = 0.3;
/// Days between the births of ramps.
const RAMP_EVERY_D: f64 = 7.0;
/// Least age in the spacing of onsets \[d\].
const LEAST_AGE_D: f64 = 0.01;
/// ln of the part of R from which a change may be followed by another, and copies kept for each shape of it.
const LN_SURE: f64 = 9.21;
const AGAIN_SLOTS: usize = 3;
/// Largest ln R reported: beyond, it is infinite for every purpose.
const GREATEST_LN: f64 = 300.0;

/// Shape of a change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Shape {
    /// At once, of a few per cent.
    Small,
    /// At once, of tens of per cent.
    Large,
    /// Gradually, at a rate per year.
    Ramp,
}

impl Shape {
    /// All shapes.
    pub const ALL: [Self; 3] = [Self::Small, Self::Large, Self::Ramp];

    /// Prior standard deviation: share of the force; per year for ramps.
    pub(super) const fn size(self) -> f64 {
        match self {
            Self::Small => 0.015,
            Self::Large => 0.12,
            Self::Ramp => 0.05,
        }
    }

    /// Number of particles kept.
    const fn slots(self) -> usize {
        match self {
            Self::Small => 10,
            Self::Large => 4,
            Self::Ramp => 6,
        }
    }

    /// Share of births.
    pub(super) const fn share(self) -> f64 {
        match self {
            Self::Large => 0.25,
            Self::Small | Self::Ramp => 0.375,
        }
    }

    /// Regressor of a change that began `age_d` days ago.
    pub(super) fn regressor(self, age_d: f64) -> f64 {
        match self {
            Self::Small | Self::Large => 1.0,
            Self::Ramp => age_d / YEAR_D,
        }
    }
}

/// A bank in which the force has changed since an onset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Particle {
    pub shape: Shape,
    /// Onset of its bank \[d\]: the first period with the change.
    pub onset: f64,
    /// Period of its latest change, and whether that is not the first \[d\].
    pub latest: f64,
    pub is_again: bool,
    /// Onsets it stands for.
    pub onsets: Onsets,
    /// ln W.
    pub ln_weight: f64,
    pub bank: Bank,
}

impl Particle {
    /// ln of its part of R.
    pub(super) fn ln_part(&self) -> f64 {
        self.ln_weight + libm::log(self.shape.share())
    }
}

/// Null bank and onset particles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Detector {
    pub(super) prior: BankPrior,
    pub(super) null: Bank,
    pub(super) particles: Vec<Particle>,
    /// Ramp that goes on since before the first period: it has no part in R, but in what is said of a change.
    pub(super) standing: Option<Particle>,
    periods: usize,
    /// Number of periods since the null bank began or was restarted.
    fresh: usize,
    /// Start of the last period's first record \[d\].
    began: Option<f64>,
    /// Birth of the last ramp \[d\], start of the first record of that period, and periods since.
    ramp: Option<[f64; 2]>,
    ramp_periods: usize,
}

impl Detector {
    /// A detector before the first period.
    pub fn new(prior: BankPrior) -> Self {
        Self {
            null: Bank::new(&prior),
            prior,
            particles: Vec::new(),
            standing: None,
            periods: 0,
            fresh: 0,
            began: None,
            ramp: None,
            ramp_periods: 0,
        }
    }

    /// The same, beside a ramp that may have begun before the first period, that of a day; `limit`: periods between onsets.
    pub(super) fn beside_standing_ramp(mut self, day: f64, limit: f64) -> Self {
        let weight = STANDING_ODDS * limit.max(1.0) / Shape::Ramp.share();
        self.standing = Some(Particle {
            shape: Shape::Ramp,
            onset: day,
            latest: day,
            is_again: false,
            // As well as ramps are dated: those of a week before and after cannot be told from it.
            onsets: Onsets::between(day - RAMP_EVERY_D, day + RAMP_EVERY_D),
            ln_weight: libm::log(weight),
            bank: self.null.with_change(Shape::Ramp.size()),
        });
        self
    }

    /// A period as the banks take it.
    pub(super) fn row(&self, seen: &Seen) -> Option<Row> {
        let mut row = Row::new(&self.prior, seen)?;
        row.unread = self.unread(seen);
        Some(row)
    }

    /// Variance of a ratio by what the temperature did since its last reading. It is one for all banks, by the slopes of the null bank: no
    /// bank may gain from slopes that would make it less.
    pub(super) fn unread(&self, seen: &Seen) -> f64 {
        seen.unread_k2
            .map_or(0.0, |unread_k2| self.null.unread(unread_k2))
    }

    /// Predictive law of a period under no change; `None` for a period that cannot be used.
    pub fn predict(&self, seen: &Seen) -> Option<Law> {
        let row = self.row(seen)?;
        let mut null = self.null.clone();
        null.advance(&self.passage(seen.day));
        Some(null.law(&row))
    }

    /// Learns a period; returns its predictive law before it was learned, or `None` for a period that cannot be used (not
    /// finite, another number of columns), which changes nothing.
    pub fn step(&mut self, seen: &Seen) -> Option<Law> {
        self.take(self.row(seen)?, seen)
    }

    /// Learns a period of which the variance by what the temperature did since its last reading is known.
    pub(super) fn step_with(&mut self, seen: &Seen, unread: f64) -> Option<Law> {
        let row = Row::new(&self.prior, seen)?;
        self.take(Row { unread, ..row }, seen)
    }

    fn take(&mut self, mut row: Row, seen: &Seen) -> Option<Law> {
        let (passage, mut workspace) = (self.passage(seen.day), Workspace::default());
        if self.fresh >= BEFORE {
            self.bear(passage.day, seen);
        }
        if self.prior.again > 0.0 {
            self.bear_again(passage.day);
        }
        self.null.advance(&passage);
        let law = self.null.law(&row);
        let under_null = (self.null).learn(&self.prior, &row, &passage, &mut workspace);
        for particle in self.particles.iter_mut().chain(&mut self.standing) {
            let h = particle.shape.regressor(passage.day - particle.onset);
            particle.bank.advance(&passage);
            let under_change =
                (particle.bank).learn(&self.prior, row.with_onset(h), &passage, &mut workspace);
            particle.bank.prune();
            particle.ln_weight += under_change - under_null;
        }
        self.periods += 1;
        self.fresh += 1;
        self.began = Some(seen.began);
        Some(law)
    }

    /// Passage of time from the last period.
    pub(super) fn passage(&self, day: f64) -> Passage {
        Passage::new(&self.prior, self.null.day, day)
    }

    /// Adds the particles born in a period. A period in the middle of which the force changed is a mixture, which looks wild, and
    /// the next is the first to show the change: an onset lies after the first record of the period before.
    fn bear(&mut self, day: f64, seen: &Seen) {
        self.ramp_periods += 1;
        for shape in Shape::ALL {
            let weight = match shape {
                Shape::Small | Shape::Large => 1.0,
                Shape::Ramp if self.ramp.is_some_and(|[last, _]| day - last < RAMP_EVERY_D) => continue,
                Shape::Ramp => self.ramp_periods as f64,
            };
            let mut after = self.began;
            if shape == Shape::Ramp {
                after = self.ramp.map(|[_, began]| began).or(after);
                (self.ramp, self.ramp_periods) = (Some([day, seen.began]), 0);
            }
            self.make_room(shape, false, day);
            self.particles.push(Particle {
                shape,
                onset: day,
                latest: day,
                is_again: false,
                onsets: Onsets::between(after.unwrap_or(seen.began), seen.measured),
                ln_weight: libm::log(weight),
                bank: self.null.with_change(shape.size()),
            });
        }
    }

    /// Adds copies of the heaviest particle of which the force changes again in a period. A ramp ends with it.
    fn bear_again(&mut self, day: f64) {
        if !self.weights().any(|weight| weight > LN_SURE) {
            return;
        }
        for shape in [Shape::Small, Shape::Large] {
            self.make_room(shape, true, day);
        }
        let heaviest = self
            .weights()
            .enumerate()
            .max_by(|one, other| one.1.total_cmp(&other.1));
        let Some((at, weight)) = heaviest else { return };
        let again = self.prior.again;
        let parent = &mut self.particles[at];
        parent.ln_weight += libm::log1p(-again);
        let parent = parent.clone();
        let so_far = parent.shape.regressor(day - parent.onset);
        for shape in [Shape::Small, Shape::Large] {
            self.particles.push(Particle {
                shape,
                latest: day,
                is_again: true,
                ln_weight: weight + libm::log(0.5 * again / shape.share()),
                onsets: parent.onsets.clone(),
                bank: parent.bank.changed_again(so_far, shape.size()),
                ..parent
            });
        }
    }

    /// Merges two particles of a shape, with a first change or with another, if its slots are full: of the neighbours closest in ln(age),
    /// not the newest, the heavier is kept with the weight of both.
    fn make_room(&mut self, shape: Shape, is_again: bool, day: f64) {
        let places: Vec<usize> = (0..self.particles.len())
            .filter(|&at| self.particles[at].shape == shape && self.particles[at].is_again == is_again)
            .collect();
        let slots = if is_again { AGAIN_SLOTS } else { shape.slots() };
        if places.len() < slots {
            return;
        }
        let ln_age = |at: usize| libm::log((day - self.particles[at].latest).max(LEAST_AGE_D));
        let mut closest: Option<(f64, usize, usize)> = None;
        for pair in places[..places.len() - 1].windows(2) {
            let distance = ln_age(pair[0]) - ln_age(pair[1]);
            if closest.is_none_or(|(least, ..)| distance < least) {
                closest = Some((distance, pair[0], pair[1]));
            }
        }
        let Some((_, older, newer)) = closest else { return };
        let weights = [self.particles[older].ln_weight, self.particles[newer].ln_weight];
        let sum = ln_sum(weights.into_iter());
        let share = libm::exp(weights[1] - sum);
        let onsets = (self.particles[older].onsets).with(&self.particles[newer].onsets, share);
        let (stays, goes) = if weights[0] >= weights[1] {
            (older, newer)
        } else {
            (newer, older)
        };
        self.particles[stays].ln_weight = sum;
        self.particles[stays].onsets = onsets;
        self.particles.remove(goes);
    }

    /// R of Shiryaev and Roberts; alarm where it exceeds the average run length to a false alarm, in periods.
    pub fn statistic(&self) -> f64 {
        self.statistic_since(None)
    }

    /// The part of R by changes that began after a time \[d\]: at most R, so that its bound holds.
    pub fn statistic_since(&self, after: Option<f64>) -> f64 {
        libm::exp(ln_sum(self.weights_since(after)).min(GREATEST_LN))
    }

    /// ln of each particle's part of R.
    pub(super) fn weights(&self) -> impl Iterator<Item = f64> + Clone {
        self.weights_since(None)
    }

    /// ln of each particle's part of R by changes that began after a time \[d\].
    pub(super) fn weights_since(&self, after: Option<f64>) -> impl Iterator<Item = f64> + Clone {
        self.particles.iter().map(move |particle| {
            let weight = particle.ln_part();
            match after {
                None => weight,
                Some(_) => weight + libm::log(particle.onsets.later_than(after)),
            }
        })
    }

    /// Number of periods learned.
    pub fn periods(&self) -> usize {
        self.periods
    }

    /// Number of periods since it began or was restarted.
    pub fn fresh(&self) -> usize {
        self.fresh
    }

    /// Start of the last period's first record \[d\].
    pub fn began(&self) -> Option<f64> {
        self.began
    }

    /// Time of the last period \[d\].
    pub fn last_day(&self) -> Option<f64> {
        self.null.day
    }

    /// Prior of the bank.
    pub fn prior(&self) -> &BankPrior {
        &self.prior
    }

    /// A ratio drawn from the predictive law of a period under no change; `None` for a period that cannot be used.
    pub fn draw<R: rand::Rng>(&self, seen: &Seen, generator: &mut R) -> Option<f64> {
        let row = self.row(seen)?;
        let mut null = self.null.clone();
        let passage = self.passage(seen.day);
        null.advance(&passage);
        null.draw(&self.prior, &row, &passage, generator)
    }

    /// Sets the probability of a jump of the residual force in a period by the spacing of readings.
    pub fn set_sparse(&mut self, is_sparse: bool) {
        self.prior.set_sparse(is_sparse);
    }

    /// Forgets the changes it suspects; what it learned stays.
    pub(super) fn forget_suspicions(&mut self) {
        self.particles.clear();
    }

    /// Restarts after an accepted change: coefficients stay known, the level is learned again, R is zero.
    pub fn restart(&mut self) {
        self.null.loosen(&self.prior);
        self.particles.clear();
        self.standing = None;
        (self.fresh, self.ramp, self.ramp_periods) = (0, None, 0);
    }
}

/// ln of the sum of exponentials.
pub(super) fn ln_sum(terms: impl Iterator<Item = f64> + Clone) -> f64 {
    let greatest = terms.clone().fold(f64::NEG_INFINITY, f64::max);
    if greatest == f64::NEG_INFINITY {
        return greatest;
    }
    greatest + libm::log(terms.map(|term| libm::exp(term - greatest)).sum())
}

#[cfg(test)]
mod tests;
