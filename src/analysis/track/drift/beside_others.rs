//! Tests of rods that are joined by others once all have a baseline: what was learned of the temperature holds beside their median.

use super::filters::FILTERS_D;
use super::first_weeks::air;
use super::others::Others;
use super::period::Period;
use super::stand_in::{Ratios, Rod, period};
use super::watch::{DriftWatch, Finding, Terms};
use super::{Filters, ThermalPrior};
use crate::numerics::random;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

const DAY_S: f64 = 86_400.0;
const STATED_SD: f64 = 1e-3;
const LAG_H: f64 = 15.0;
/// First day of the records in the air.
const FIRST: usize = 40;

/// Days by which an other rod's records begin before its baseline is there.
const BASELINE_D: usize = 40;
/// Others of the site, at most.
const NAMES: [&str; 3] = ["b", "c", "d"];

/// Course of a site.
pub(super) struct Story<'a> {
    /// Days on which the other rods have a baseline.
    pub known: &'a [usize],
    pub days: usize,
    /// Day and size of a change of the rod, and of one that the first of the others is told to have.
    pub change: (usize, f64),
    pub drift: Option<(usize, f64)>,
}

/// Nothing happens to any rod.
pub(super) const QUIET: Story = Story {
    known: &[30, 33],
    days: 365,
    change: (0, 0.0),
    drift: None,
};

/// Findings about a rod beside others, by day. There is a reading a day, between which all follow weather that no reading shows: the
/// others' median does.
pub(super) fn follow(seed: u64, story: &Story) -> (DriftWatch, Vec<Finding>) {
    let mut generator = random::stream(83, seed);
    let air = air(&mut generator, story.days);
    let keep = (-1.0 / LAG_H).exp();
    let mut state = air[0];
    let follows = |celsius: &f64| {
        state = keep * state + (1.0 - keep) * celsius;
        state
    };
    let lagged: Vec<f64> = air.iter().map(follows).collect();
    let per_k: Vec<f64> = (0..=story.known.len())
        .map(|_| -generator.random_range(0.002..0.01))
        .collect();
    let mut filters = Filters::default();
    filters.push((FIRST - 1) as f64 + 10.0 / 24.0, air[(FIRST - 1) * 24 + 10]);
    let reference_c = filters.celsius();
    let terms = Terms {
        limit: 3652.0,
        thermal: Some(ThermalPrior {
            slope_mean_per_k: -0.005,
            slope_sd_per_k: 0.01,
            curvature_sd_per_k2: 1e-5,
            is_sparse: true,
        }),
        reference_c: Some(reference_c),
        learning_periods: 30,
        commissioned_until: None,
        told_since: None,
    };
    let mut watch = DriftWatch::new(FIRST as f64, STATED_SD);
    let mut history: Vec<Period> = Vec::new();
    let mut ratios = vec![Ratios::new(); story.known.len()];
    let mut found = Vec::new();
    for day in 0..story.days {
        let midnight = FIRST + day;
        let index = midnight as i64;
        filters.push(midnight as f64 + 10.0 / 24.0, air[midnight * 24 + 10]);
        let mut ratio = |per_k: &f64| {
            let error: f64 = StandardNormal.sample(&mut generator);
            per_k * (lagged[midnight * 24 + 11] - reference_c) + STATED_SD * error
        };
        let own = ratio(&per_k[0]);
        for ((ratios, per_k), known) in ratios.iter_mut().zip(&per_k[1..]).zip(story.known) {
            let ratio = ratio(per_k);
            if day + BASELINE_D >= *known {
                ratios.insert(index, ratio);
            }
        }
        if let Some((_, size)) = story.drift.filter(|(since, _)| day >= *since) {
            ratios[0].entry(index).and_modify(|ratio| *ratio += size);
        }
        let others = story.known.iter().zip(&ratios).zip(NAMES).enumerate();
        let rods: Vec<Rod> = others
            .map(|(place, ((known, ratios), name))| Rod {
                name,
                ratios: if day >= *known {
                    ratios.clone()
                } else {
                    Ratios::new()
                },
                last: (day >= *known).then_some(index),
                moved: None,
                off: None,
                drift: story
                    .drift
                    .filter(|(since, _)| place == 0 && day >= *since)
                    .map(|(since, size)| ((FIRST + since) as i64, size)),
            })
            .collect();
        let others = Others::new(&rods);
        let (since, size) = story.change;
        let change = if day >= since { size } else { 0.0 };
        let filtered: Option<[f64; FILTERS_D.len()]> = filters.at(midnight as f64 + 11.0 / 24.0);
        let mut period = Period {
            delta_sd: STATED_SD,
            ..period(index, own + change, filtered)
        };
        period.charted = Some(watch.step(&terms, &period, &history, true, &others, DAY_S));
        history.push(period);
        found.push(watch.finding(&others, index, false));
    }
    (watch, found)
}

/// Rods to which nothing happens, the others known from day 30 and 33 on. The promise is 365 of 3652 at most, 4.8 of 48. By a detector that
/// went on with the slopes of the first weeks it was 26.
#[test]
fn others_that_join_are_no_change() {
    let is_told = |seed: &u64| {
        let (_, found) = follow(*seed, &QUIET);
        found.iter().any(|found| *found != Finding::Quiet)
    };
    let told = (0..48).filter(is_told).count();
    assert!(told <= 4, "{told} of 48");
}

/// As if the others had been there from the first day on.
#[test]
fn what_was_measured_before_they_joined_is_learned_beside_them() {
    let of = |known| {
        let story = Story {
            known: &[known; 2],
            days: 60,
            change: (20, -0.02),
            ..QUIET
        };
        follow(5, &story)
    };
    let ((early, of_early), (late, of_late)) = (of(0), of(33));
    assert_eq!(early.evidence(None), late.evidence(None));
    assert_eq!(early.size(), late.size());
    assert_eq!(of_early[33..], of_late[33..]);
    assert!(early.evidence(None) > 3652.0, "{}", early.evidence(None));
}

/// A loss that is told beside one other rod stands when a third one joins, which cannot know of it, and one after that is told as soon.
#[test]
fn a_drift_from_before_they_joined_stands() {
    let story = |change| Story {
        known: &[0, 130],
        days: 170,
        change,
        ..QUIET
    };
    let is_drift = |found: &Finding| matches!(found, Finding::Drift(_));
    let (_, found) = follow(6, &story((80, -0.03)));
    let told = found.iter().position(is_drift).unwrap();
    assert!((80..84).contains(&told), "{told}");
    assert!(found[told..].iter().all(is_drift), "{found:?}");
    let (_, found) = follow(6, &story((134, -0.03)));
    let told = found.iter().position(is_drift).unwrap();
    assert!((134..138).contains(&told), "{told}");
}

/// One of three others lost 5 % before they joined, and is told to have: its step is none of the median's.
#[test]
fn what_another_rod_lost_before_they_joined_is_no_change() {
    let story = Story {
        known: &[18, 30, 33],
        days: 90,
        drift: Some((22, -0.05)),
        ..QUIET
    };
    for seed in 0..12 {
        let (watch, found) = follow(seed, &story);
        assert!(
            found.iter().all(|found| *found == Finding::Quiet),
            "{seed}: {found:?}"
        );
        assert!(watch.evidence(None) < 365.0, "{seed}: {}", watch.evidence(None));
    }
}
