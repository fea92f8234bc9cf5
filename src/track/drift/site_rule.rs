//! The rule of a site: what the detectors of its rods mean together.
//!
//! With A the average run length to a false alarm and, for every rod, R_C of the bank with thermometer and other rods (or
//! thermometer alone) and R_P of the bank with the other rods alone:
//!
//! * both above A, each latched: the rod drifts, confirmed by the others;
//! * R_C above A for seven days while R_P is not: if at most a quarter of the other rods is above 300, the rod drifts, not
//!   confirmed by the others; else rods moved together, which is one notice of the site: thermometer, weather, or the whole
//!   structure;
//! * fewer than three rods: R_C alone, and nobody can tell force from thermometer.

use serde::{Deserialize, Serialize};

/// Days an unconfirmed alarm waits for the other rods.
pub const WAIT_D: f64 = 7.0;
/// R above which another rod is moving, too.
pub const MOVING: f64 = 300.0;
/// Greatest share of other rods that may move beside a rod that drifts.
pub const SHARE: f64 = 0.25;
/// Fewest rods that can confirm one another.
pub const FEWEST: usize = 3;

/// Standing of one rod before the rule: the statistics after its last period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Standing {
    /// R of the bank with the thermometer, and other rods if there are enough; `None` while it cannot run.
    pub with_thermometer: Option<f64>,
    /// R of the bank with the other rods alone; `None` while it cannot run.
    pub with_others: Option<f64>,
}

/// Memory of the rule for one rod.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Latch {
    /// First time \[d\] R_C was above A.
    pub with_thermometer: Option<f64>,
    /// First time \[d\] R_P was above A.
    pub with_others: Option<f64>,
    /// Standing of the rod when it was decided last.
    pub told: Option<Told>,
}

/// Decision on a rod.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Told {
    /// It drifts, as the thermometer and the other rods say.
    Confirmed,
    /// It drifts by the thermometer; the other rods neither confirm it nor move with it.
    Unconfirmed,
    /// It moved together with other rods.
    Together,
    /// It drifts, or its thermometer does: there are too few rods to tell.
    ForceOrThermometer,
}

impl Latch {
    /// Latches what is above `limit` now.
    fn latch(&mut self, day: f64, standing: Standing, limit: f64) {
        for (latch, statistic) in [
            (&mut self.with_thermometer, standing.with_thermometer),
            (&mut self.with_others, standing.with_others),
        ] {
            if latch.is_none() && statistic.is_some_and(|statistic| statistic > limit) {
                *latch = Some(day);
            }
        }
    }
}

/// Decides on every rod of a site after a period: `latches` beside `standings`, one per rod. Returns the rods whose
/// decision changed; a confirmed drift is final, an earlier decision may become a confirmed drift.
pub fn decide(day: f64, limit: f64, standings: &[Standing], latches: &mut [Latch]) -> Vec<(usize, Told)> {
    for (latch, &standing) in latches.iter_mut().zip(standings) {
        latch.latch(day, standing, limit);
    }
    let rods = standings.len();
    let moving: Vec<bool> = latches
        .iter()
        .zip(standings)
        .map(|(latch, standing)| {
            latch.with_thermometer.is_some() || standing.with_thermometer.is_some_and(|statistic| statistic > MOVING)
        })
        .collect();
    let all_moving = moving.iter().filter(|&&is_moving| is_moving).count();
    let mut changed = Vec::new();
    for (rod, latch) in latches.iter_mut().enumerate().take(rods) {
        let Some(since) = latch.with_thermometer else { continue };
        let others_moving = all_moving - usize::from(moving[rod]);
        let told = if rods < FEWEST {
            Told::ForceOrThermometer
        } else if latch.with_others.is_some() {
            Told::Confirmed
        } else if day - since < WAIT_D {
            continue;
        } else if others_moving as f64 <= SHARE * (rods - 1) as f64 {
            Told::Unconfirmed
        } else {
            Told::Together
        };
        let is_better = match latch.told {
            None => true,
            Some(before) => told == Told::Confirmed && before != Told::Confirmed,
        };
        if is_better {
            latch.told = Some(told);
            changed.push((rod, told));
        }
    }
    changed
}
