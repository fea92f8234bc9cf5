//! The rule of a site: what the detectors of its rods mean together.
//!
//! With A the average run length to a false alarm and, for every rod, R_C of the bank with thermometer and other rods (or
//! thermometer alone) and R_P of the bank with the other rods alone:
//!
//! * both above A, each latched: the rod drifts, confirmed by the others;
//! * R_C above A while R_P is not: if at most a quarter of the other rods is above 50, the rod drifts, not confirmed by the
//!   others; if they are for seven days, rods moved together, which is one notice of the site: thermometer, weather, or the
//!   whole structure;
//! * fewer than three rods: R_C alone, and nobody can tell force from thermometer.

use serde::{Deserialize, Serialize};

/// Days an alarm beside rods that move waits before it is told as one of the site.
pub const WAIT_D: f64 = 7.0;
/// R above which another rod is moving, too. With 50 none of 50 rods beside a thermometer that drifts by 0.03 K a day was told to
/// drift, nor one of 50 beside one that jumps by 2 K; with 100 one of each, with 300 six and three. Losses of 1 % were told as soon.
pub const MOVING: f64 = 50.0;
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

/// Decides on every rod of a site after a period that all of them have closed: `latches` beside `standings`, one per rod. Returns the rods whose
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
            latch.with_thermometer.is_some()
                || standing
                    .with_thermometer
                    .is_some_and(|statistic| statistic > MOVING)
        })
        .collect();
    let all_moving = moving.iter().filter(|&&is_moving| is_moving).count();
    let mut changed = Vec::new();
    for (rod, latch) in latches.iter_mut().enumerate().take(rods) {
        let Some(since) = latch.with_thermometer else {
            continue;
        };
        let others_moving = all_moving - usize::from(moving[rod]);
        let told = if rods < FEWEST {
            Told::ForceOrThermometer
        } else if latch.with_others.is_some() {
            Told::Confirmed
        } else if others_moving as f64 <= SHARE * (rods - 1) as f64 {
            Told::Unconfirmed
        } else if day - since < WAIT_D {
            continue;
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

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: f64 = 3652.0;

    fn standing(with_thermometer: f64, with_others: f64) -> Standing {
        Standing {
            with_thermometer: Some(with_thermometer),
            with_others: Some(with_others),
        }
    }

    /// Days 0 to 9 with these standings, and when what was told.
    fn told(standings: &[Standing]) -> Vec<(u32, usize, Told)> {
        let mut latches = vec![Latch::default(); standings.len()];
        (0..10)
            .flat_map(|day| {
                let changed = decide(f64::from(day), LIMIT, standings, &mut latches);
                changed.into_iter().map(move |(rod, told)| (day, rod, told))
            })
            .collect()
    }

    #[test]
    fn both_banks_confirm_at_once() {
        let quiet = standing(50.0, 50.0);
        assert_eq!(
            told(&[standing(5e3, 5e3), quiet, quiet]),
            [(0, 0, Told::Confirmed)]
        );
        assert_eq!(told(&[standing(50.0, 1e9), quiet, quiet]), []);
    }

    #[test]
    fn the_thermometer_alone_is_told_beside_quiet_rods_and_waits_beside_moving_ones() {
        let (quiet, loud, moving) = (standing(50.0, 50.0), standing(5e3, 50.0), standing(51.0, 50.0));
        assert_eq!(
            told(&[loud, quiet, quiet, quiet, quiet]),
            [(0, 0, Told::Unconfirmed)]
        );
        assert_eq!(
            told(&[loud, moving, quiet, quiet, quiet]),
            [(0, 0, Told::Unconfirmed)]
        );
        assert_eq!(
            told(&[loud, moving, moving, quiet, quiet]),
            [(7, 0, Told::Together)]
        );
        let all = [loud, loud, loud];
        assert_eq!(told(&all), [0, 1, 2].map(|rod| (7, rod, Told::Together)));
    }

    #[test]
    fn few_rods_cannot_tell_force_from_thermometer() {
        let alone = Standing {
            with_thermometer: Some(5e3),
            with_others: None,
        };
        assert_eq!(told(&[alone]), [(0, 0, Told::ForceOrThermometer)]);
        assert_eq!(
            told(&[alone, standing(1.0, 1.0)]),
            [(0, 0, Told::ForceOrThermometer)]
        );
    }

    #[test]
    fn crossings_are_latched_and_confirmation_may_come_late() {
        let quiet = standing(50.0, 50.0);
        let mut latches = vec![Latch::default(); 3];
        let mut on = |day, first| decide(day, LIMIT, &[first, quiet, quiet], &mut latches);
        assert_eq!(on(0.0, standing(5e3, 50.0)), [(0, Told::Unconfirmed)]);
        assert_eq!(on(3.0, quiet), []);
        assert_eq!(on(20.0, standing(50.0, 5e3)), [(0, Told::Confirmed)]);
        assert_eq!(on(30.0, standing(9e3, 9e3)), []);
    }
}
