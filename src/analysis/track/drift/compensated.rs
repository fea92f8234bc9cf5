//! A detector that knows the temperature, with its regressors and the level of commissioning from which changes are measured.

use super::filters::FILTERS_D;
use super::{BankPrior, Detector, Regressors, Seen};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Fewest periods of commissioning for a level while no change is reported.
const FEWEST_PERIODS: f64 = 10.0;

/// Fewest periods of a level that a reported change ended: an onset is considered from the fifth period on.
const FEWEST_BEFORE_CHANGE: f64 = 3.0;

/// Most of the latest periods that can be withdrawn: a change is reported within so many, or is too small to
/// affect a mean.
const WITHDRAWN_PERIODS: usize = 10;

/// The detector with temperature.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Compensated {
    pub detector: Detector,
    regressors: Regressors,
    /// True if the other rods are among its columns.
    pub knows_others: bool,
    /// True if temperature is among its columns.
    pub knows_temperature: bool,
    /// Mean ratio and columns over the periods of commissioning.
    level: Level,
}

/// Means over the periods of commissioning.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Level {
    /// Times of the first and the last \[d\].
    days: [f64; 2],
    periods: f64,
    /// True if no more periods are taken, however few they are.
    has_ended: bool,
    ratio: f64,
    columns: Vec<f64>,
    /// The last of them: time, ratio, columns.
    recent: VecDeque<(f64, f64, Vec<f64>)>,
}

impl Compensated {
    /// One before its first period: `reference_c` is the reference temperature, `origin` the day of the period, `limit` R of an alarm.
    pub fn new(prior: BankPrior, reference_c: f64, origin: f64, limit: f64, knows_temperature: bool) -> Self {
        Self {
            detector: Detector::new(prior).beside_standing_ramp(origin, limit),
            regressors: Regressors { reference_c, origin },
            knows_others: false,
            knows_temperature,
            level: Level::default(),
        }
    }

    /// One beside it that knows the other rods, too, before its first period.
    pub fn beside_others(&self, prior: BankPrior, limit: f64) -> Self {
        Self {
            detector: Detector::new(prior).beside_standing_ramp(self.regressors.origin, limit),
            knows_others: true,
            level: Level::default(),
            ..*self
        }
    }

    /// Day of the first period.
    pub fn origin(&self) -> f64 {
        self.regressors.origin
    }

    /// Regressors of a period or record; `None` without its temperature, or without the other rods where they are needed.
    pub fn columns(
        &self,
        day: f64,
        filtered_c: Option<&[f64; FILTERS_D.len()]>,
        median: Option<f64>,
    ) -> Option<Vec<f64>> {
        match (self.knows_temperature, self.knows_others) {
            (false, _) => Some(self.regressors.blind(day)),
            (true, false) => Some(self.regressors.thermal(day, filtered_c?)),
            (true, true) => Some(self.regressors.thermal_and_peers(day, filtered_c?, median?)),
        }
    }

    /// Change since commissioning at the same temperature: (y - y_0) - (X - X_0) b, with the means y_0, X_0 of commissioning.
    /// `is_told`: after a reported change, before which there may have been few periods.
    pub fn change(&self, seen: &Seen, limit: f64, is_told: bool) -> Option<(f64, f64)> {
        self.level.change(&self.detector, seen, limit, is_told)
    }

    /// Takes a period measured at a time \[d\] into the level, if it is one of the first `periods`; `is_told`: after a reported change.
    pub fn learn_level(&mut self, measured: f64, ratio: f64, columns: &[f64], periods: usize, is_told: bool) {
        self.level.learn(measured, ratio, columns, periods, is_told);
    }

    /// Ends the level with the periods so far: a change that was told while the baseline was learned comes after them.
    pub fn end_level(&mut self) {
        self.level.has_ended |= self.level.periods > 0.0;
    }

    /// Removes the latest periods since the earliest credible onset from the level.
    pub fn withdraw(&mut self, onset: f64) {
        self.level.withdraw(onset);
    }
}

impl Level {
    /// Takes a period of commissioning. One after a reported change is left out: the level would follow the change.
    fn learn(&mut self, day: f64, ratio: f64, columns: &[f64], periods: usize, is_told: bool) {
        if self.has_ended
            || self.periods >= periods as f64
            || (is_told && self.periods >= FEWEST_BEFORE_CHANGE)
        {
            return;
        }
        if self.periods == 0.0 {
            self.days[0] = day;
        }
        self.days[1] = day;
        self.columns.resize(columns.len(), 0.0);
        self.periods += 1.0;
        let share = self.periods.recip();
        self.ratio += share * (ratio - self.ratio);
        for (mean, column) in self.columns.iter_mut().zip(columns) {
            *mean += share * (column - *mean);
        }
        if self.recent.len() == WITHDRAWN_PERIODS {
            self.recent.pop_front();
        }
        self.recent.push_back((day, ratio, columns.to_vec()));
    }

    /// Removes the latest periods since an onset, as long as any level is left without them.
    fn withdraw(&mut self, onset: f64) {
        while self.periods > FEWEST_BEFORE_CHANGE
            && let Some((_, ratio, columns)) = self.recent.pop_back_if(|(day, ..)| *day >= onset)
        {
            self.periods -= 1.0;
            let share = self.periods.recip();
            self.ratio += share * (self.ratio - ratio);
            for (mean, column) in self.columns.iter_mut().zip(&columns) {
                *mean += share * (*mean - column);
            }
            if let Some((day, ..)) = self.recent.back() {
                self.days[1] = *day;
            }
        }
    }

    fn change(&self, detector: &Detector, seen: &Seen, limit: f64, is_told: bool) -> Option<(f64, f64)> {
        let fewest = match (self.has_ended, is_told) {
            (true, _) => 1.0,
            (false, true) => FEWEST_BEFORE_CHANGE,
            (false, false) => FEWEST_PERIODS,
        };
        if self.periods < fewest {
            return None;
        }
        let columns: Vec<f64> = seen
            .columns
            .iter()
            .zip(&self.columns)
            .map(|(x, mean)| x - mean)
            .collect();
        detector.change_from_level(
            &Seen {
                ratio: seen.ratio - self.ratio,
                columns: &columns,
                ..*seen
            },
            limit,
            self.periods,
            self.days[1] - self.days[0],
        )
    }
}
