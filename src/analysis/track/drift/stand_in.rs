//! Tests of rods of a site that come, go, and lose their inputs: other inputs take the place of those that are missing.

use super::filters::FILTERS_D;
use super::others::{MOVING, Movement, Neighbour, Others};
use super::period::{Period, start_of};
use super::watch::{DriftWatch, Finding, Terms, Witness};
use super::{Filters, ThermalPrior};
use crate::numerics::random;
use crate::signal::record::Timestamp;
use rand_distr::{Distribution, StandardNormal};
use std::collections::BTreeMap;

const DAY_S: f64 = 86_400.0;
const LIMIT: f64 = 3652.0;
const NOISE: f64 = 0.002;

pub(super) type Ratios = BTreeMap<i64, f64>;

/// Another rod as it shows itself in one period.
#[derive(Debug)]
pub(super) struct Rod {
    pub name: &'static str,
    /// Ratios by period.
    pub ratios: Ratios,
    /// Its last period; `None` before it has a baseline.
    pub last: Option<i64>,
    pub moved: Option<Moved>,
    /// Deviation of its last period, and standard deviation.
    pub off: Option<(f64, f64)>,
    /// Period from which on it is told to drift, and size.
    pub drift: Option<(i64, f64)>,
}

/// A change that another rod shows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moved {
    day: f64,
    size: f64,
}

impl Neighbour for Rod {
    fn name(&self) -> &str {
        self.name
    }
    fn ratio_in(&self, index: i64, _: f64) -> Option<f64> {
        self.ratios.get(&index).copied()
    }
    fn latest_deviations(&self, _: f64) -> [Option<(f64, f64)>; 2] {
        [self.off, None]
    }
    fn latest_record(&self) -> Option<(Timestamp, f64)> {
        None
    }
    fn doubted_loss(&self) -> Option<(Timestamp, f64, f64)> {
        None
    }
    fn last_period(&self) -> Option<i64> {
        self.last
    }
    fn usual_distance(&self) -> i64 {
        1
    }
    fn evidence(&self, since: Option<f64>) -> f64 {
        let is_younger = |moved: &Moved| since.is_none_or(|since| moved.day > since);
        self.moved.filter(is_younger).map_or(0.0, |_| 2.0 * MOVING)
    }
    fn evidence_alone(&self, since: Option<f64>) -> f64 {
        self.evidence(since)
    }
    fn size(&self) -> f64 {
        self.moved.map_or(0.0, |moved| moved.size)
    }
    fn moved_alone(&self, since: f64) -> f64 {
        if self.evidence(Some(since)) > 0.0 {
            self.size()
        } else {
            0.0
        }
    }
    fn slope_per_k(&self) -> Option<f64> {
        None
    }
    fn moved_beside_others(&self) -> f64 {
        self.drift.map_or(0.0, |(_, size)| size)
    }
    fn is_in_doubt(&self, _: i64, _: f64) -> bool {
        false
    }
    fn drifts(&self) -> bool {
        self.drift.is_some()
    }
    fn drifts_in(&self, index: i64, _: f64) -> bool {
        self.drift.is_some_and(|(since, _)| index >= since)
    }
    fn has_baseline(&self) -> bool {
        self.last.is_some()
    }
    fn is_confirmed(&self) -> bool {
        false
    }
    fn has_moved_with_others(&self) -> bool {
        false
    }
}

/// The rod that is watched, and the days of its site.
struct Site {
    watch: DriftWatch,
    filters: Filters,
    /// Periods so far, and the other rods' ratios.
    periods: Vec<Period>,
    ratios: BTreeMap<&'static str, Ratios>,
    limit: f64,
    /// True if findings are new for ever.
    is_new: bool,
    /// Found so far, by day.
    found: Vec<Finding>,
}

/// One day of it.
struct Day {
    /// Reading of the thermometer \[degC\]; `None` if it is dead.
    read_c: Option<f64>,
    /// Change of force.
    change: f64,
    /// Loss of the first of the other rods.
    loss: f64,
    /// Slopes of the other rods \[1/K\]; `None` if one is configured and not measured.
    others: Vec<(&'static str, Option<f64>)>,
    /// Change that each of them shows.
    moved: Option<Moved>,
}

impl Day {
    /// A day on which all is well.
    fn of(day: i64) -> Self {
        Self {
            read_c: Some(air(day)),
            change: 0.0,
            loss: 0.0,
            others: vec![("b", Some(-0.008)), ("c", Some(-0.012))],
            moved: None,
        }
    }

    fn alone(day: i64) -> Self {
        Self {
            others: Vec::new(),
            ..Self::of(day)
        }
    }
}

/// Temperature of all rods on a day.
fn air(day: i64) -> f64 {
    let day = day as f64;
    10.0 + 6.0 * (day / 58.0).sin() + 3.0 * (1.7 * day).sin() + 2.0 * (day / 3.1).cos()
}

/// A period of one record.
pub(super) fn period(index: i64, delta: f64, filtered_c: Option<[f64; FILTERS_D.len()]>) -> Period {
    Period {
        index,
        start: start_of(index, DAY_S),
        began: None,
        measured: None,
        records: 1,
        delta,
        delta_sd: NOISE,
        filtered_c,
        unread_k2: None,
        lagged_c: None,
        misfit: Vec::new(),
        not_axial_p: 1.0,
        charted: None,
    }
}

/// An error of a period, another for every source.
fn noise(day: i64, source: u64) -> f64 {
    let draw: f64 = StandardNormal.sample(&mut random::stream(source, day as u64));
    NOISE * draw
}

impl Site {
    fn new() -> Self {
        Self {
            watch: DriftWatch::new(0.0, NOISE),
            filters: Filters::default(),
            periods: Vec::new(),
            ratios: BTreeMap::new(),
            limit: LIMIT,
            is_new: false,
            found: Vec::new(),
        }
    }

    /// Follows the rod, -1 % a kelvin, over days.
    fn follow(&mut self, days: std::ops::Range<i64>, day: impl Fn(i64) -> Day) -> &mut Self {
        let terms = Terms {
            limit: self.limit,
            thermal: Some(ThermalPrior {
                slope_mean_per_k: -0.01,
                slope_sd_per_k: 0.01,
                curvature_sd_per_k2: 1e-5,
                is_sparse: false,
            }),
            reference_c: Some(10.0),
            learning_periods: 30,
            commissioned_until: None,
            told_since: None,
        };
        for index in days {
            let today = day(index);
            let warmer = air(index) - 10.0;
            if let Some(celsius) = today.read_c {
                self.filters.push(index as f64, celsius);
            }
            let rods: Vec<Rod> = (1..)
                .zip(&today.others)
                .map(|(source, &(name, slope))| {
                    let loss = if source == 1 { today.loss } else { 0.0 };
                    let ratio = slope.map(|slope| slope * warmer + noise(index, source) - loss);
                    let ratios = self.ratios.entry(name).or_default();
                    ratios.extend(ratio.map(|ratio| (index, ratio)));
                    Rod {
                        name,
                        ratios: ratios.clone(),
                        last: Some(index),
                        moved: today.moved,
                        off: None,
                        drift: None,
                    }
                })
                .collect();
            let others = Others::new(&rods);
            let delta = -0.01 * warmer + noise(index, 0) + today.change;
            let filtered_c = today.read_c.map(|celsius| [celsius; FILTERS_D.len()]);
            let mut period = period(index, delta, filtered_c);
            period.charted = Some((self.watch).step(&terms, &period, &self.periods, false, &others, DAY_S));
            self.periods.push(period);
            self.found.push(self.watch.finding(&others, index, self.is_new));
        }
        self
    }

    fn is_quiet_since(&self, day: usize) -> bool {
        self.found[day..].iter().all(|found| *found == Finding::Quiet)
    }
}

/// A poor thermometer, which reads 1 K wrong and from day 120 on 6 K too much: the temperature alone shows a change, the other rods none.
fn shifted(day: i64) -> Day {
    let off = if day < 120 { 0.0 } else { 6.0 } + noise(day, 9) / NOISE;
    Day {
        read_c: Some(air(day) + off),
        ..Day::of(day)
    }
}

#[test]
fn rods_that_leave_bring_back_nothing_they_explained() {
    let mut site = Site::new();
    site.follow(0..200, shifted);
    assert!(site.is_quiet_since(0), "{:?}", site.found);
    assert!(
        site.watch.evidence_alone(None) > LIMIT,
        "{}",
        site.watch.evidence_alone(None)
    );
    site.follow(200..240, |day| Day {
        others: vec![("b", Some(-0.008))],
        ..shifted(day)
    });
    assert!(site.is_quiet_since(200), "{:?}", &site.found[200..]);
    assert!(site.watch.evidence(None) < LIMIT, "{}", site.watch.evidence(None));
    // What begins then is told.
    site.follow(240..246, |day| Day {
        others: vec![("b", Some(-0.008))],
        change: -0.1,
        ..shifted(day)
    });
    assert!(
        site.found[240..].contains(&Finding::Drift(Witness::Alone)),
        "{:?}",
        &site.found[240..]
    );
}

#[test]
fn a_watch_made_anew_without_the_other_rods_tells_nothing_they_explained() {
    let mut site = Site::new();
    site.follow(0..200, |day| Day {
        others: Vec::new(),
        ..shifted(day)
    });
    assert!(site.watch.evidence(None) > LIMIT);
    site.watch.looked_beside_others(199.5);
    let before = site.found.len();
    site.follow(200..260, shifted);
    assert!(site.is_quiet_since(before), "{:?}", &site.found[before..]);
    site.follow(260..266, |day| Day {
        change: -0.1,
        ..shifted(day)
    });
    assert!(!site.is_quiet_since(260), "{:?}", &site.found[260..]);
}

#[test]
fn a_third_rod_takes_no_sight_from_the_first() {
    for lost in [122, 100] {
        let mut site = Site::new();
        site.follow(0..135, |day| Day {
            change: if day < lost { 0.0 } else { -0.03 },
            others: if day < 120 {
                vec![("b", Some(-0.008))]
            } else {
                Day::of(day).others
            },
            ..Day::of(day)
        });
        let told = site.found.iter().position(|found| *found != Finding::Quiet);
        let lost = lost as usize;
        assert!(
            told.is_some_and(|day| (lost..lost + 3).contains(&day)),
            "{lost}: {told:?}"
        );
        // A drift that was told before stays so.
        let after = told.unwrap();
        assert!(
            site.found[after..]
                .iter()
                .all(|found| matches!(found, Finding::Drift(_))),
            "{lost}: {:?}",
            &site.found[after..]
        );
    }
}

#[test]
fn what_the_last_reading_showed_is_not_lost_with_the_thermometer() {
    let mut site = Site::new();
    let change = |day| if day < 90 { 0.0 } else { -0.3 };
    site.follow(0..91, |day| Day {
        change: change(day),
        ..Day::alone(day)
    });
    assert!(site.is_quiet_since(0));
    site.follow(91..94, |day| Day {
        change: change(day),
        read_c: None,
        ..Day::alone(day)
    });
    assert!(
        site.found[91..].contains(&Finding::Drift(Witness::Blind)),
        "{:?} {}",
        &site.found[91..],
        site.watch.evidence(None)
    );
}

#[test]
fn a_reading_that_is_missing_makes_no_rod_move() {
    let mut site = Site::new();
    // A month much warmer than all before, which the temperature explains and nothing else does.
    let warm = |day: i64| if day < 60 { air(day) } else { air(day) + 25.0 };
    site.follow(0..66, |day| Day {
        read_c: Some(warm(day)),
        change: -0.01 * (warm(day) - air(day)),
        ..Day::alone(day)
    });
    assert!(site.watch.is_blind_above());
    site.follow(66..67, |day| Day {
        read_c: None,
        change: -0.01 * (warm(day) - air(day)),
        ..Day::alone(day)
    });
    assert!(
        site.watch.evidence_alone(None) <= MOVING,
        "{}",
        site.watch.evidence_alone(None)
    );
    assert!(site.is_quiet_since(0));
}

#[test]
fn a_notice_of_the_site_needs_the_evidence_of_all_its_rods() {
    let last = |limit: f64| {
        let mut site = Site::new();
        site.limit = limit;
        site.follow(0..66, |day| Day {
            read_c: Some(air(day) + if day < 62 { 0.0 } else { 1.0 }),
            others: vec![("b", None), ("c", None), ("d", None)],
            moved: Some(Moved {
                day: 62.0,
                size: 0.01,
            }),
            ..Day::of(day)
        });
        (site.found[65], site.watch.evidence(None))
    };
    let (_, evidence) = last(LIMIT);
    assert!(evidence > LIMIT, "{evidence}");
    assert_eq!(last(2.0 * evidence).0, Finding::Quiet);
    assert_eq!(last(0.5 * evidence).0, Finding::Waiting);
    assert_eq!(last(0.3 * evidence).0, Finding::Waiting);
    assert_eq!(last(0.2 * evidence).0, Finding::Common);
}

/// A loss of the first of the others moves their median, and R over all the past is large from a thermometer that was moved months ago:
/// the rod waits for the other one, unless that changed months ago, too.
#[test]
fn what_another_rod_brings_about_waits_whatever_showed_before() {
    let found = |moved: f64| {
        let mut site = Site::new();
        site.is_new = true;
        site.follow(0..180, shifted);
        assert!(site.is_quiet_since(0), "{:?}", site.found);
        assert!(site.watch.evidence_alone(None) > LIMIT);
        site.follow(180..183, |day| Day {
            loss: 0.06,
            moved: Some(Moved {
                day: moved,
                size: -0.06,
            }),
            ..shifted(day)
        });
        assert!(site.watch.evidence(None) > LIMIT);
        site.found.split_off(180)
    };
    let (with_it, long_before) = (found(180.0), found(60.0));
    assert_eq!(with_it, [Finding::Quiet; 3]);
    assert!(
        long_before.contains(&Finding::Drift(Witness::Confirmed)),
        "{long_before:?}"
    );
}

/// The first rod with its second record after a thermometer's jump finds one period of each other rod: no evidence, but off as it is.
#[test]
fn a_rod_whose_last_period_is_off_as_well_moves_with_it() {
    let movement = Movement {
        since: 98.0,
        age_d: 2.0,
        size: -0.09,
        slope_per_k: None,
    };
    let moving = |off: (f64, f64)| {
        let rod = |name| Rod {
            name,
            ratios: Ratios::new(),
            last: Some(100),
            moved: None,
            off: Some(off),
            drift: None,
        };
        Others::new(&[rod("b"), rod("c")]).moving(100, &movement)
    };
    assert_eq!(moving((-0.08, 0.004)), 2);
    // The other way, by less than it would, and within its noise.
    assert_eq!(moving((0.08, 0.004)), 0);
    assert_eq!(moving((-0.02, 0.004)), 0);
    assert_eq!(moving((-0.08, 0.05)), 0);
}
