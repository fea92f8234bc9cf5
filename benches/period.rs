//! Cost of one period of one rod among four, through the real trackers; `cargo bench --bench period`.
//!
//! Items are records, one a rod and period, given as frequencies. Bytes are those of a rod's state as it is kept; the memory of the
//! one read is the state in memory.

use divan::counter::{BytesCount, ItemsCount};
use divan::{AllocProfiler, Bencher, black_box};
use rand_distr::{Distribution, StandardNormal};
use std::sync::Arc;
use tirante::analysis::lab::synthesis::{Change, Fate, SiteYears, World};
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::Exact;
use tirante::analysis::rod::beam::forward::ForwardModel;
use tirante::analysis::rod::emulator::ReducedModel;
use tirante::analysis::signal::record::{RodId, Timestamp};
use tirante::analysis::track::{
    AlarmSettings, Input, LogMode, Observation, Others, State, TrackPlan, TrackSettings, Tracker,
};
use tirante::analysis::{Rod, RodPrior};

#[global_allocator]
static ALLOCATIONS: AllocProfiler = AllocProfiler::system();

const RODS: usize = 4;
const MODES: usize = 3;
const LOG_SD: f64 = 1e-3;
const DAY_S: f64 = 86_400.0;
const RECORD_S: f64 = 120.0;
const MIDNIGHT: Timestamp = Timestamp::from_nanos(1_740_787_200_000_000_000);
/// Days before those that are measured, and the day of the change.
const BEFORE: usize = 180;
const CHANGE: f64 = 150.4;
const MEASURED: usize = 28;

/// Names, worlds, and the change of the first rod.
const SITES: [(&str, &str, f64); 4] = [
    ("undisturbed", "benign", 0.0),
    ("alarm stands", "benign", -0.03),
    ("sparse", "sparse", 0.0),
    ("harsh", "harsh", 0.0),
];

fn main() {
    divan::main();
}

/// A record of one of the rods.
type OfRod = (usize, Input);

/// The trackers after the first days, and the records of the next.
fn site(name: &str) -> Option<(Vec<Tracker>, Vec<OfRod>)> {
    let (_, world, relative) = SITES.into_iter().find(|site| site.0 == name)?;
    let world = World::named(world, &mut random::stream(3, 0))?;
    let change = Change {
        start_d: CHANGE,
        over_d: 0.0,
        relative,
    };
    let days = BEFORE + MEASURED;
    let years = SiteYears::new(&world, RODS, days, MIDNIGHT, Some(&change), 3);
    let mut trackers = trackers()?;
    let mut records = records(&years)?;
    let later = records.partition_point(|(start, _)| start.seconds_since(MIDNIGHT) < BEFORE as f64 * DAY_S);
    let later = records.split_off(later);
    for (_, (place, input)) in &records {
        step(&mut trackers, *place, input);
    }
    Some((trackers, later.into_iter().map(|(_, record)| record).collect()))
}

fn trackers() -> Option<Vec<Tracker>> {
    let rod = Rod::square("rod").length_m(9.5).side_m(0.04).axial_force_n(5e4);
    let rod = rod.youngs_modulus_pa(2e11).density_kg_m3(7850.0).springs_n_m(1e5);
    let mut settings = rod.settings().ok()?;
    settings.prior = RodPrior::todi();
    let rods = (0..RODS).map(|number| {
        settings.rod = RodId(format!("rod-{number}"));
        let plan = TrackPlan::new(
            &settings,
            Arc::new(ReducedModel::new(*settings.prior.parameterisation())),
            TrackSettings::default(),
            AlarmSettings::default(),
            String::from("bench"),
        );
        Tracker::new(Arc::new(plan))
    });
    Some(rods.collect())
}

/// Records of the prior's central rod at four forces, in the order of their times.
fn records(years: &SiteYears) -> Option<Vec<(Timestamp, OfRod)>> {
    let prior = RodPrior::todi();
    let model = Exact::new(*prior.parameterisation());
    let mut generator = random::stream(3, 1);
    let mut normal = || -> f64 { StandardNormal.sample(&mut generator) };
    let mut records = Vec::new();
    for (place, moments) in years.rods.iter().enumerate() {
        let mut read = 0;
        for moment in moments.iter().filter(|moment| moment.fate == Fate::Measured) {
            let start = moment.start;
            let end = start.plus_seconds(RECORD_S);
            let until = years.readings.partition_point(|reading| reading.time <= end);
            let mut theta = prior.centre();
            theta[0] *= (1.0 + 0.1 * place as f64) * moment.force();
            let mut frequency_hz = [0.0; MODES];
            model.frequencies(&theta, &mut frequency_hz).ok()?;
            let mode = |(n, frequency_hz): (usize, &f64)| LogMode {
                order: n + 1,
                log_frequency: frequency_hz.ln() + LOG_SD * normal(),
                log_sd: LOG_SD,
            };
            let input = Input::Identified(Observation {
                start,
                duration_s: RECORD_S,
                modes: frequency_hz.iter().enumerate().map(mode).collect(),
                readings: years.readings[read..until].to_vec(),
                rms: 1e-5,
                conflict: 0.0,
            });
            read = until;
            records.push((start, (place, input)));
        }
    }
    records.sort_by_key(|(start, _)| *start);
    Some(records)
}

fn step(trackers: &mut [Tracker], place: usize, input: &Input) {
    let (before, rest) = trackers.split_at_mut(place);
    if let Some((tracker, after)) = rest.split_first_mut() {
        let others = Others::new(before.iter().chain(after.iter()).map(Tracker::state));
        black_box(tracker.step_beside(input, &[], &others));
    }
}

#[divan::bench(args = SITES.map(|site| site.0), sample_count = 20, sample_size = 1)]
fn records_of_four_rods(bencher: Bencher, name: &str) {
    let Some((trackers, records)) = site(name) else {
        return;
    };
    let records = &records;
    bencher
        .counter(ItemsCount::new(records.len()))
        .with_inputs(|| trackers.clone())
        .bench_local_values(|mut trackers| {
            for (place, input) in records {
                step(&mut trackers, *place, input);
            }
            trackers
        });
}

#[divan::bench(args = SITES.map(|site| site.0), sample_count = 20)]
fn state_of_a_rod(bencher: Bencher, name: &str) {
    let state = site(name).and_then(|(trackers, _)| postcard::to_stdvec(trackers.first()?.state()).ok());
    if let Some(state) = state {
        bencher
            .counter(BytesCount::new(state.len()))
            .bench_local(|| postcard::from_bytes::<State>(black_box(&state)));
    }
}
