//! Large losses, and changes after a change, where temperature or baseline are missing or wrong: what is told, and what stays told.

use crate::rods::Rods;
use crate::scenario::{DAY_S, Scenario, raised, told};
use rand::RngExt;
use tirante::analysis::lab::synthesis::{AddedMass, FrequencyErrors};
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::Exact;
use tirante::analysis::rod::beam::forward::ForwardModel;
use tirante::analysis::signal::record::RodId;
use tirante::analysis::track::{Alarm, Kind, Observation, Verdict, What, alternatives};

/// A rod restrained by this share of what stiff walls do.
fn restrained(days: usize, restraint: f64) -> Scenario {
    let mut scenario = Scenario::new(days);
    scenario.rod.thermal.restraint = restraint;
    scenario
}

/// Observations without a temperature from a day on.
fn dark(scenario: &Scenario, seed: u64, from: usize) -> Vec<Observation> {
    let mut observations = scenario.observations(seed);
    for observation in &mut observations[from..] {
        observation.readings.clear();
    }
    observations
}

fn first(verdicts: &[Verdict], kind: Kind) -> Option<usize> {
    let all = raised(verdicts).into_iter();
    all.filter(|(_, raised)| *raised == kind)
        .map(|(index, _)| index)
        .next()
}

fn cleared(verdicts: &[Verdict], kind: Kind) -> Option<usize> {
    let all = told(verdicts, What::Cleared).into_iter();
    all.filter(|(_, over)| *over == kind)
        .map(|(index, _)| index)
        .next()
}

#[test]
fn a_loss_behind_a_dead_thermometer_stays_a_limit_until_the_ratio_is_back() {
    let scenario = restrained(180, 0.5).step(105.5, -0.4);
    let (_, verdicts) = scenario.follow(&dark(&scenario, 301, 100));
    assert_eq!(
        first(&verdicts, Kind::Limit),
        Some(106),
        "{:?}",
        raised(&verdicts)
    );
    assert_eq!(cleared(&verdicts, Kind::Limit), None);
    assert_eq!(
        cleared(&verdicts, Kind::Drift),
        None,
        "{:?}",
        told(&verdicts, What::Cleared)
    );
    // The rod was tightened again: the shares are of the force it had.
    let back = restrained(180, 0.5).step(105.5, -0.4).step(140.5, 0.4);
    let (_, verdicts) = back.follow(&dark(&back, 301, 100));
    assert_eq!(first(&verdicts, Kind::Limit), Some(106));
    assert!(
        matches!(cleared(&verdicts, Kind::Limit), Some(142..=146)),
        "{:?}",
        told(&verdicts, What::Cleared)
    );
}

#[test]
fn a_thermometer_that_reads_too_low_is_no_sudden_loss() {
    let scenario = restrained(130, 0.9);
    let mut observations = scenario.observations(302);
    for reading in observations[100..].iter_mut().flat_map(|one| &mut one.readings) {
        reading.celsius -= 15.0;
    }
    let (_, verdicts) = scenario.follow(&observations);
    for event in verdicts.iter().flat_map(|verdict| &verdict.events) {
        assert!(
            !event.alarm.message.contains("any temperature"),
            "{}",
            event.alarm.message
        );
        // With no other rod nothing tells it from a loss: the message says so.
        assert!(
            event.alarm.message.contains("thermometer"),
            "{}",
            event.alarm.message
        );
    }
    let last = verdicts[129].at_reference.expect("compensated").ratio;
    assert!(last.mean < 0.9, "{last:?}");
}

#[test]
fn a_loss_while_the_baseline_is_learned_is_told_with_its_first_or_second_record() {
    for (loss, kind, record) in [(-0.6, Kind::Limit, 25), (-0.1, Kind::Drift, 26)] {
        let scenario = Scenario::new(40).step(24.5, loss);
        let (_, verdicts) = scenario.follow(&scenario.observations(303));
        assert_eq!(
            first(&verdicts, kind),
            Some(record),
            "{loss}: {:?}",
            raised(&verdicts)
        );
    }
    let calm = restrained(60, 1.0);
    for seed in 310..316 {
        let (_, verdicts) = calm.follow(&calm.observations(seed));
        assert_eq!(first(&verdicts, Kind::Limit), None, "{seed}");
    }
}

#[test]
fn a_baseline_ends_with_a_loss_that_was_told_while_it_was_learned() {
    // Two records come before the loss, three or nine.
    for (start_d, loss) in [(1.5, 0.4), (2.5, 0.4), (8.5, 0.2), (8.5, 0.4), (8.5, 0.7)] {
        let scenario = restrained(70, 0.3).step(start_d, -loss);
        let history = scenario.history(306);
        let observations: Vec<Observation> = history.iter().map(|one| one.observation.clone()).collect();
        let (tracker, verdicts) = scenario.follow(&observations);
        let (all, over) = (raised(&verdicts), told(&verdicts, What::Cleared));
        let case = format!("{loss} on day {start_d}: {all:?}, over {over:?}");
        let intact = start_d.ceil() as usize;
        let times = |kind: Kind| all.iter().filter(|(_, raised)| *raised == kind).count();
        // A fifth is not more than any weather does to a rod that is not known yet: it is told as a drift.
        let (first_told, later) = if loss > 0.3 {
            (Kind::Limit, 0)
        } else {
            (Kind::Drift, 1)
        };
        assert_eq!(first(&verdicts, first_told), Some(intact + later), "{case}");
        assert_eq!(
            (times(Kind::Limit), times(Kind::Drift).min(1)),
            (1, times(Kind::Drift)),
            "{case}"
        );
        assert_eq!(
            cleared(&verdicts, Kind::Limit).or(cleared(&verdicts, Kind::Drift)),
            None,
            "{case}"
        );
        let state = tracker.state();
        let records = state.segment.baseline.as_ref().expect("thirty records").records;
        assert!((2..=intact).contains(&records), "{records} records: {case}");
        let Some(at_reference) = verdicts.last().and_then(|last| last.at_reference) else {
            assert!(loss > 0.5, "beyond the prepared range: {case}");
            continue;
        };
        // The share of the force at no special temperature; that at the reference differs by what weather moves.
        let left = history.last().expect("records").relative_force;
        let ratio = at_reference.ratio;
        assert!(
            (ratio.mean - left).abs() < 0.02 + 3.0 * ratio.sd,
            "{ratio:?}, {left}: {case}"
        );
        assert!(ratio.q975 < 1.0 - 0.5 * loss, "{ratio:?}: {case}");
    }
}

#[test]
fn a_loss_is_suspected_with_its_first_record_and_the_next_one_decides() {
    // While the baseline is learned, and long after.
    for (days, first_record) in [(40, 25), (130, 121)] {
        let calm = Scenario::new(days);
        let lost = Scenario::new(days).step(first_record as f64 - 0.5, -0.1);
        let (quiet, loss) = (calm.observations(304), lost.observations(304));
        let (_, verdicts) = lost.follow(&loss);
        assert_eq!(
            first(&verdicts, Kind::Suspected),
            Some(first_record),
            "{:?}",
            raised(&verdicts)
        );
        assert_eq!(
            first(&verdicts, Kind::Drift),
            Some(first_record + 1),
            "{:?}",
            raised(&verdicts)
        );
        assert_eq!(cleared(&verdicts, Kind::Suspected), Some(first_record + 1));
        // One wild record.
        let mut wild = quiet.clone();
        wild[first_record].modes.clone_from(&loss[first_record].modes);
        let (_, verdicts) = calm.follow(&wild);
        assert_eq!(raised(&verdicts), [(first_record, Kind::Suspected)]);
        assert_eq!(cleared(&verdicts, Kind::Suspected), Some(first_record + 1));
        // A rod to which nothing happens.
        let (_, verdicts) = calm.follow(&quiet);
        assert_eq!(raised(&verdicts), []);
    }
}

/// A loss that three modes agree on needs no second record; one that two show, or that the modes do not agree on, does.
#[test]
fn one_record_decides_a_large_loss_that_its_modes_agree_on() {
    let modes_of = |kept: usize| {
        move |mut record: Observation| {
            record.modes.truncate(kept);
            record
        }
    };
    // Within the prepared range and beyond it, while the baseline is learned and long after.
    for (days, record, loss) in [(40, 25, 0.4), (40, 25, 0.7), (130, 121, 0.4), (130, 121, 0.7)] {
        let lost = Scenario::new(days).step(record as f64 - 0.5, -loss);
        for (modes, later) in [(3, 0), (2, 1)] {
            let records: Vec<Observation> = (lost.observations(304).into_iter())
                .map(modes_of(modes))
                .collect();
            let (_, verdicts) = lost.follow(&records);
            let case = format!("{loss} at {record}, {modes} modes: {:?}", raised(&verdicts));
            assert_eq!(first(&verdicts, Kind::Limit), Some(record + later), "{case}");
            let suspected = (later > 0).then_some(record);
            assert_eq!(first(&verdicts, Kind::Suspected), suspected, "{case}");
        }
        // One wild record: all modes fell, each by another share of force.
        let calm = Scenario::new(days);
        let mut wild: Vec<Observation> = calm.observations(304).into_iter().map(modes_of(3)).collect();
        let shares: [f64; 3] = if loss > 0.5 {
            [0.35, 0.5, 0.42]
        } else {
            [0.8, 0.55, 0.7]
        };
        for (mode, share) in wild[record].modes.iter_mut().zip(shares) {
            mode.log_frequency += 0.5 * share.ln();
        }
        let (_, verdicts) = calm.follow(&wild);
        let case = format!("{loss} at {record}, wild: {:?}", raised(&verdicts));
        assert_eq!(first(&verdicts, Kind::Limit), None, "{case}");
        assert_eq!(first(&verdicts, Kind::Suspected), Some(record), "{case}");
    }
}

#[test]
fn a_drift_that_grows_after_it_was_acknowledged_is_told_anew() {
    let mut scenario = Scenario::new(230).step(120.5, -0.025).step(170.5, -0.05);
    scenario.alarm.limit_loss = 0.3;
    let observations = scenario.observations(304);
    let (mut tracker, before) = scenario.follow(&observations[..150]);
    assert_eq!(raised(&before).len(), 1, "{:?}", raised(&before));
    let alarm = tracker.state().alarms[0].clone();
    let now = scenario.simulation.start.plus_seconds(149.9 * DAY_S);
    assert_eq!(tracker.acknowledge(&alarm.id, now).len(), 1);
    let after = crate::scenario::follow_on(&mut tracker, &observations[150..]);
    assert!(
        matches!(raised(&after)[..], [(22..=26, Kind::Drift)]),
        "{:?}",
        raised(&after)
    );
    let events = || after.iter().flat_map(|one| &one.events);
    let grown = events()
        .find(|one| one.what == What::Raised)
        .expect("it is told")
        .alarm
        .clone();
    let told: Vec<_> = events()
        .map(|one| (one.what, &one.alarm.id, &one.alarm.message))
        .collect();
    assert!(
        grown.id != alarm.id && grown.message.contains("told before"),
        "{told:#?}"
    );
    let size = grown.change.expect("a drift has a size").size;
    assert!((-0.085..-0.055).contains(&size.mean), "{size:?}");
    // Repeated every week with the size of both changes.
    let repeats: Vec<_> = after
        .iter()
        .flat_map(|one| &one.events)
        .filter(|one| one.what == What::Repeated)
        .collect();
    assert!((4..=8).contains(&repeats.len()), "{}", repeats.len());
    for repeat in repeats {
        let size = repeat.alarm.change.as_ref().expect("a drift has a size").size;
        assert!((-0.09..-0.05).contains(&size.mean), "{size:?}");
    }
}

/// Probabilities of a change of force that the alarms of a restrained rod state through a season: on day 100 it loses a share of its
/// force, and its modes shift by so much besides. Its modes' errors differ from day to day.
fn force_through_a_season(seed: u64, loss: f64, shifts: [f64; 3]) -> Vec<f64> {
    let errors = FrequencyErrors {
        log_sd: 3e-4,
        ..restrained(0, 0.9).errors
    };
    let scenario = Scenario {
        errors,
        ..restrained(220, 0.9).step(100.5, -loss)
    };
    let mut observations = scenario.observations(310 + seed);
    let mut generator = random::stream(310 + seed, 1);
    for (day, observation) in observations.iter_mut().enumerate() {
        for (mode, shift) in observation.modes.iter_mut().zip(shifts) {
            mode.log_frequency += if day > 100 { shift } else { 0.0 };
            // Stated on the safe side, by up to three times.
            mode.log_sd *= generator.random_range(1.0..3.0);
        }
    }
    let (_, verdicts) = scenario.follow(&observations);
    let alarms = verdicts.iter().flat_map(|verdict| &verdict.alarms);
    let explained = alarms.filter_map(|alarm| alarm.alternatives.as_ref());
    explained
        .map(|one| one.probability(alternatives::Kind::Force))
        .collect()
}

/// Modes whose errors differ weigh the days of a season differently, and the force moves by a tenth meanwhile: that is no pattern of
/// another kind of change.
#[test]
fn a_loss_of_a_restrained_rod_stays_one_of_force_through_a_season() {
    for seed in 0..6 {
        let told = force_through_a_season(seed, 0.04, [0.0; 3]);
        let least = told.iter().copied().fold(f64::NAN, f64::min);
        assert!(least > 1.0 / 21.0, "{seed}: {told:?}");
    }
}

#[test]
fn mass_or_loose_supports_of_a_restrained_rod_do_not_become_force_through_a_season() {
    let scenario = restrained(1, 0.9);
    let prior = &scenario.analysis.prior;
    let exact = Exact::new(*prior.parameterisation());
    let (mut tight, mut loose) = ([0.0; 3], [0.0; 3]);
    let mut theta = prior.centre();
    exact.frequencies(&theta, &mut tight).expect("a taut rod");
    theta[4..6].iter_mut().for_each(|spring| *spring *= 0.2);
    exact.frequencies(&theta, &mut loose).expect("a taut rod");
    let loosened = std::array::from_fn(|n| (loose[n] / tight[n]).ln());
    for shifts in [loosened, [-0.015; 3]] {
        for seed in 0..3 {
            let told = force_through_a_season(seed, 0.0, shifts);
            let most = told.iter().copied().fold(f64::NAN, f64::max);
            assert!(most < 20.0 / 21.0, "{shifts:?} {seed}: {told:?}");
        }
    }
}

/// Alarms of a kind that a rod raised, and those that ended, by day.
fn of_rod(verdicts: &[(f64, RodId, Verdict)], rod: &str, what: What) -> Vec<(u32, Kind)> {
    let own = verdicts.iter().filter(|(_, known, _)| known.0 == rod);
    own.flat_map(|(day, _, verdict)| verdict.events.iter().map(move |event| (*day as u32, event)))
        .filter(|(_, event)| event.what == what)
        .map(|(day, event)| (day, event.alarm.kind))
        .collect()
}

/// A thermometer that works for the first time knows nothing of the force before: the loss is not its zero.
#[test]
fn a_loss_before_the_first_thermometer_is_not_ended_by_it() {
    let lost = restrained(260, 0.5).step(100.5, -0.4);
    let without = |scenario: &Scenario| {
        let mut observations = scenario.observations(301);
        observations[..150]
            .iter_mut()
            .for_each(|one| one.readings.clear());
        observations
    };
    let (_, verdicts) = lost.follow(&without(&lost));
    let (all, over) = (raised(&verdicts), told(&verdicts, What::Cleared));
    assert!(
        first(&verdicts, Kind::Limit).is_some_and(|day| day < 104),
        "{all:?}"
    );
    assert!(
        first(&verdicts, Kind::Drift).is_some_and(|day| day < 110),
        "{all:?}"
    );
    assert_eq!(cleared(&verdicts, Kind::Limit), None, "{over:?}");
    assert_eq!(cleared(&verdicts, Kind::Drift), None, "{over:?}");
    let shown = verdicts.last().and_then(|last| last.at_reference);
    assert_eq!(shown, None, "the force before is not known by a temperature");
    // The rod was tightened again.
    let back = restrained(260, 0.5).step(100.5, -0.4).step(200.5, 0.4);
    let (_, verdicts) = back.follow(&without(&back));
    let over = told(&verdicts, What::Cleared);
    assert!(
        cleared(&verdicts, Kind::Limit).is_some_and(|day| day > 200),
        "{over:?}"
    );
}

#[test]
fn a_loss_beside_the_others_before_the_first_thermometer_is_not_ended_by_it() {
    for seed in 621..624 {
        let rods = Rods::new(3, 200, seed, &[(90.5, -0.12)], 0.0);
        let verdicts = rods.follow(|day, mut record| {
            if day < 140.0 {
                record.readings.clear();
            }
            Some(record)
        });
        let [told, over] = [What::Raised, What::Cleared].map(|what| of_rod(&verdicts, "a", what));
        let latched = |all: &[(u32, Kind)]| all.iter().any(|(_, kind)| kind.is_latched());
        assert!(
            told.iter().any(|(_, kind)| *kind == Kind::Drift),
            "{seed}: {told:?}"
        );
        assert!(!latched(&over), "{seed}: {told:?}, over {over:?}");
    }
}

/// Records of a rod until a day, with all its alarms acknowledged then, and those after it.
fn acknowledged(scenario: &Scenario, observations: &[Observation], day: usize) -> (Vec<Alarm>, Vec<Verdict>) {
    let (mut tracker, _) = scenario.follow(&observations[..day]);
    let before = tracker.state().alarms.clone();
    let now = scenario.simulation.start.plus_seconds((day as f64 - 0.1) * DAY_S);
    for alarm in &before {
        tracker.acknowledge(&alarm.id, now);
    }
    (
        before,
        crate::scenario::follow_on(&mut tracker, &observations[day..]),
    )
}

#[test]
fn a_further_loss_under_a_limit_is_told_without_a_temperature() {
    let one = restrained(180, 0.1).step(100.5, -0.15);
    let two = restrained(180, 0.1).step(100.5, -0.15).step(140.5, -0.3);
    for seed in 301..304 {
        let (before, after) = acknowledged(&two, &dark(&two, seed, 0), 130);
        let kinds: Vec<Kind> = before.iter().map(|alarm| alarm.kind).collect();
        assert!(kinds.contains(&Kind::Limit), "{seed}: {kinds:?}");
        let told: Vec<_> = raised(&after)
            .into_iter()
            .map(|(day, kind)| (day + 130, kind))
            .collect();
        assert!(
            matches!(told[..], [(141 | 142, Kind::Limit), ..]),
            "{seed}: {told:?}"
        );
        assert_eq!(
            told.iter().filter(|(_, kind)| *kind == Kind::Limit).count(),
            1,
            "{seed}: {told:?}"
        );
        // Nobody has acknowledged the first: it is repeated with the second.
        let (_, verdicts) = two.follow(&dark(&two, seed, 0));
        let repeats: Vec<(usize, String)> = (verdicts.iter().enumerate())
            .flat_map(|(day, verdict)| verdict.events.iter().map(move |event| (day, event)))
            .filter(|(_, event)| event.what == What::Repeated && event.alarm.kind == Kind::Limit)
            .map(|(day, event)| (day, event.alarm.message.clone()))
            .collect();
        let further = repeats
            .iter()
            .find(|(_, message)| message.contains("fell further"));
        assert!(
            further.is_some_and(|(day, _)| matches!(day, 141 | 142)),
            "{seed}: {repeats:?}"
        );
        // The first alone, through the same weather.
        let (_, after) = acknowledged(&one, &dark(&one, seed, 0), 110);
        assert_eq!(first(&after, Kind::Limit), None, "{seed}: {:?}", raised(&after));
    }
}

#[test]
fn a_loss_after_a_mass_is_told_anew() {
    let mut scenario = Scenario::new(230).step(120.5, -0.12).step(170.5, -0.3);
    scenario.rod.added_mass = Some(AddedMass {
        mass_kg: 15.0,
        at: 0.5,
        start_d: 120.0,
    });
    let (before, after) = acknowledged(&scenario, &scenario.observations(25), 165);
    let kinds: Vec<Kind> = before.iter().map(|alarm| alarm.kind).collect();
    assert!(
        kinds.contains(&Kind::NotAxial) && kinds.contains(&Kind::Limit),
        "{kinds:?}"
    );
    let told = raised(&after);
    assert!(
        told.iter()
            .any(|(day, kind)| (6..=12).contains(day) && *kind == Kind::NotAxial),
        "{told:?}"
    );
}

#[test]
fn a_drift_that_grows_is_told_anew_beside_the_others_alone() {
    for seed in 621..624 {
        let rods = Rods::new(3, 180, seed, &[(90.5, -0.06), (140.5, -0.06)], 0.0);
        let verdicts = rods.follow(|_, mut record| {
            record.readings.clear();
            Some(record)
        });
        let own = verdicts.iter().filter(|(_, rod, _)| rod.0 == "a");
        let events =
            own.flat_map(|(day, _, verdict)| verdict.events.iter().map(move |event| (*day as u32, event)));
        let told: Vec<_> = events
            .filter(|(_, event)| {
                event.alarm.kind == Kind::Drift && event.alarm.message.contains("told before")
            })
            .map(|(day, event)| (day, event.what, event.alarm.message.clone()))
            .collect();
        assert!(
            told.first().is_some_and(|(day, ..)| (141..=150).contains(day)),
            "{seed}: {told:?}"
        );
    }
}
