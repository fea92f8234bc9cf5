//! Speed of the way from samples to labelled natural frequencies, one core.

// Machinery of tests and benches: a panic is the report.
#![allow(clippy::unwrap_used)]

use divan::{Bencher, black_box};
use tirante::analysis::rod::prior::RodPrior;
use tirante::analysis::signal::modes::{
    LabelPlan, ModalPlan, ModeSettings, MotionKind, Parts, Search, refine,
};
use tirante::analysis::signal::record::{Excitation, Record};
use tirante::analysis::signal::spectrum::{
    PeakSettings, Spectrum, Transforms, Welch, WelchSettings, Window, pick_peaks,
};

#[path = "../tests/harness/simulator/mod.rs"]
mod simulator;
use simulator::{SimulatedMode, ambient_sd, simulate};

fn main() {
    divan::main();
}

const FS: f64 = 200.0;

fn record(seconds: f64, excitation: Excitation) -> Record {
    let modes: Vec<SimulatedMode> = [4.492, 9.288, 13.252]
        .iter()
        .map(|&frequency_hz| SimulatedMode {
            frequency_hz,
            damping: 0.005,
            ambient: if excitation == Excitation::Ambient {
                ambient_sd(frequency_hz, 0.005, 40.0, 1.0, FS)
            } else {
                0.1
            },
            pull: if excitation == Excitation::Ambient {
                0.0
            } else {
                100.0
            },
        })
        .collect();
    simulate(7, FS, seconds, &modes, 1.0, excitation)
}

fn labels() -> LabelPlan {
    LabelPlan::new(&RodPrior::todi(), &[0.02; 3], ModeSettings::default()).unwrap()
}

fn plan() -> ModalPlan {
    ModalPlan::new(WelchSettings::default(), PeakSettings::default(), labels())
}

fn spectrum(transforms: &Transforms, record: &Record) -> Spectrum {
    let settings = WelchSettings::default();
    let nperseg = settings.nperseg(record.fs_hz, record.samples.len());
    let welch = Welch::plan_with(
        transforms,
        record.fs_hz,
        nperseg,
        settings.noverlap(nperseg),
        settings.window,
    )
    .unwrap();
    welch.run(&record.samples).unwrap()
}

#[divan::bench(args = [36_000, 360_000, 3_600_000])]
fn welch_16384(bencher: Bencher, samples: usize) {
    let x: Vec<f64> = (0..samples).map(|i| ((i * i) as f64).sin()).collect();
    let welch = Welch::plan(1000.0, 16_384, 8_192, Window::Hann).unwrap();
    bencher.bench_local(|| welch.run(black_box(&x)).unwrap());
}

#[divan::bench(args = [60.0, 600.0, 3600.0])]
fn welch_and_peaks(bencher: Bencher, seconds: f64) {
    let record = record(seconds, Excitation::Ambient);
    let transforms = Transforms::default();
    bencher.bench_local(|| {
        let spectrum = spectrum(&transforms, black_box(&record));
        pick_peaks(&spectrum, &PeakSettings::default(), 2.0, 60.0)
    });
}

#[divan::bench(args = [20.0, 60.0, 600.0, 3600.0])]
fn refine_ambient(bencher: Bencher, seconds: f64) {
    let record = record(seconds, Excitation::Ambient);
    let transforms = Transforms::default();
    let spectrum = spectrum(&transforms, &record);
    let peaks = pick_peaks(&spectrum, &PeakSettings::default(), 2.0, 60.0);
    let parts = Parts::of(&record, None, true);
    let search = Search {
        tones: &[],
        masks: &[],
        line_hz: spectrum.df_hz,
        parts: &parts,
    };
    bencher.bench_local(|| refine(&transforms, black_box(&record), &peaks, &search));
}

#[divan::bench(args = [20.0, 60.0, 600.0])]
fn refine_free_decay(bencher: Bencher, seconds: f64) {
    let record = record(seconds, Excitation::FreeDecay);
    let transforms = Transforms::default();
    let spectrum = spectrum(&transforms, &record);
    let peaks = pick_peaks(&spectrum, &PeakSettings::default(), 2.0, 60.0);
    let parts = Parts::of(&record, None, true);
    let search = Search {
        tones: &[],
        masks: &[],
        line_hz: spectrum.df_hz,
        parts: &parts,
    };
    bencher.bench_local(|| refine(&transforms, black_box(&record), &peaks, &search));
}

#[divan::bench]
fn label_three_peaks(bencher: Bencher) {
    let plan = plan();
    let resonances = plan
        .search()
        .evidence(&record(60.0, Excitation::Ambient), 2.0, 60.0)
        .unwrap()
        .resonances;
    bencher.bench_local(|| {
        plan.labels()
            .label(black_box(&resonances), (0.0, 96.0), MotionKind::Ambient)
    });
}

#[divan::bench]
fn prepare_labels(bencher: Bencher) {
    bencher.bench_local(labels);
}

#[divan::bench(args = [60.0, 600.0])]
fn identify(bencher: Bencher, seconds: f64) {
    let record = record(seconds, Excitation::Ambient);
    let plan = plan();
    bencher.bench_local(|| plan.identify(black_box(&record)));
}

#[divan::bench(args = [60.0, 600.0])]
fn identify_recognised(bencher: Bencher, seconds: f64) {
    let mut record = record(seconds, Excitation::Ambient);
    record.excitation = None;
    let plan = plan();
    bencher.bench_local(|| plan.identify(black_box(&record)));
}
