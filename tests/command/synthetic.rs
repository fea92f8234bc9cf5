//! Histories made up for the report's tests: a rod under the seasons that loses force late in the year.

use tirante::analysis::findings::{Assigned, Candidate, Multiple, Nature, Quantiles};
use tirante::analysis::inference::{MassDependence, Source, SourceShare, VarianceShares};
use tirante::analysis::record_view::{Curve, Density, PeakMark, Reason, Snapshot};
use tirante::analysis::signal::modes::{Motion, MotionKind};
use tirante::analysis::signal::record::{Envelope, RodId, Timestamp};
use tirante::analysis::track::alarm::change::Change;
use tirante::analysis::track::drift::period::{Charted, Evidence};
use tirante::analysis::track::{Alarm, Interval, Kind, Period, RodState};
use tirante::command::report_page::view::{
    RecordPoint, RejectionCount, RodReport, SegmentReport, SiteReport, ThermalLine,
};

pub const HOUR: i64 = 3600;
const DAY: i64 = 24 * HOUR;
/// 2025-01-10T00:00:00Z.
const FIRST: i64 = 1_736_467_200;
const SLOPE: f64 = -0.004;
const REFERENCE: f64 = 12.0;

pub fn time(seconds: i64) -> Timestamp {
    Timestamp::from_nanos((FIRST + seconds) * 1_000_000_000)
}

/// Deterministic scatter, about standard normal.
fn noise(i: usize, seed: u64) -> f64 {
    let mut x = (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ seed.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mut sum = 0.0;
    for _ in 0..12 {
        x ^= x << 13;
        x ^= x >> 7;
        x ^= x << 17;
        sum += (x >> 11) as f64 / (1u64 << 53) as f64;
    }
    sum - 6.0
}

fn interval(mean: f64, sd: f64) -> Interval {
    Interval {
        mean,
        sd,
        q025: mean - 1.96 * sd,
        q975: mean + 1.96 * sd,
    }
}

fn snapshot(at: Timestamp, shift: f64) -> Snapshot {
    let modes = [4.49, 9.28, 14.5].map(|hz| hz * (1.0 + shift));
    let level = |i: usize| {
        let f = 0.05 * (i + 1) as f64;
        let resonance =
            |f0: f64, height: f64| height / ((1.0 - (f / f0).powi(2)).powi(2) + (0.01 * f / f0).powi(2));
        let power =
            1e-13 + resonance(modes[0], 1e-14) + resonance(modes[1], 1e-15) + resonance(modes[2], 3e-16);
        10.0 * power.log10() + 1.2 * noise(i, 77 + (shift * 1e4) as u64)
    };
    let density = |quantity: &str, mean: f64, cv: f64, posterior: f64, posterior_cv: f64| {
        let (low, high) = (mean * (1.0 - 3.5 * cv), mean * (1.0 + 3.5 * cv));
        let bell = |mean: f64, sd: f64| -> Vec<f64> {
            let at = |i: usize| low + (high - low) * i as f64 / 95.0;
            (0..96)
                .map(|i| (-0.5 * ((at(i) - mean) / sd).powi(2)).exp() * (high - low) / (2.5066 * sd))
                .collect()
        };
        Density {
            quantity: quantity.to_owned(),
            low,
            high,
            prior: bell(mean, cv * mean),
            posterior: bell(posterior, posterior_cv * posterior),
            prior_mean_sd: (mean, cv * mean),
            posterior_mean_sd: (posterior, posterior_cv * posterior),
        }
    };
    // As programs before kept it.
    let peak = |frequency_hz, order, line| PeakMark {
        frequency_hz,
        order,
        line,
        sd_hz: None,
        damping: None,
        damping_sd: None,
        level_db: None,
        taken_for: None,
        multiple_of: None,
    };
    Snapshot {
        start: at,
        duration_s: 60.0,
        fs_hz: 200.0,
        seed: "00c0ffee00c0ffee".to_owned(),
        waveform: None,
        curve: Curve {
            first_hz: 0.05,
            step_hz: 0.05,
            level_db: (0..440).map(level).collect(),
        },
        peaks: vec![
            peak(modes[0], Some(1), false),
            peak(6.3, None, false),
            peak(modes[1], Some(2), false),
            peak(modes[2], Some(3), false),
            peak(16.67, None, true),
        ],
        hangs_on: Some(VarianceShares {
            sources: vec![
                SourceShare {
                    source: Source::Density,
                    share: 0.67,
                    if_known: 0.68,
                },
                SourceShare {
                    source: Source::Springs,
                    share: 0.33,
                    if_known: 0.31,
                },
            ],
            explained: 0.98,
            mass: MassDependence {
                force_per_mass: 1.05,
                learned: 0.03,
            },
            said: vec!["Two thirds of the force's variance comes from the density: weigh the rod".to_owned()],
        }),
        densities: vec![
            density("axial_force_n", 800e3, 0.2, 560e3, 0.17),
            density("youngs_modulus_pa", 2e11, 0.25, 1.9e11, 0.22),
            density("density_kg_m3", 7500.0, 0.1, 7400.0, 0.095),
            density("side_m", 0.07, 0.1, 0.066, 0.07),
            density("spring_left_n_m", 400e3, 0.28, 390e3, 0.28),
            density("spring_right_n_m", 400e3, 0.28, 395e3, 0.28),
        ],
        motion: None,
        label_probability: None,
        candidates: vec![],
        rejection: None,
    }
}

/// A refused record with peaks of every kind, and two assignments.
pub fn refused(at: Timestamp) -> Snapshot {
    let peak = |frequency_hz: f64, taken_for: Nature| PeakMark {
        frequency_hz,
        order: None,
        line: matches!(taken_for, Nature::Tone | Nature::Harmonic),
        sd_hz: Some(0.004),
        damping: Some(0.0021),
        damping_sd: Some(0.0003),
        level_db: Some(31.4),
        taken_for: Some(taken_for),
        multiple_of: (taken_for == Nature::Harmonic).then_some(Multiple {
            times: 2,
            frequency_hz: 8.335,
        }),
    };
    let candidate = |orders: [usize; 2], probability: f64, middle: f64| Candidate {
        modes: orders
            .iter()
            .zip([4.49, 13.2])
            .map(|(&order, frequency_hz)| Assigned { order, frequency_hz })
            .collect(),
        probability,
        axial_force_n: Some(Quantiles {
            q025: 0.8 * middle,
            q50: middle,
            q975: 1.2 * middle,
        }),
    };
    let (low, high) = (0..600)
        .map(|i| (-1e-6 * f64::from(i % 7), 1e-6 * f64::from(i % 5)))
        .unzip();
    Snapshot {
        start: at,
        seed: String::new(),
        waveform: Some(Envelope {
            step_s: 0.1,
            low,
            high,
        }),
        peaks: vec![
            peak(0.3, Nature::Drift),
            peak(4.49, Nature::Candidate),
            peak(8.335, Nature::Tone),
            peak(13.2, Nature::Candidate),
            peak(13.4, Nature::Doubtful),
            peak(16.67, Nature::Harmonic),
            peak(19.0, Nature::Broad),
        ],
        densities: vec![],
        motion: Some(Motion {
            kind: MotionKind::Blow,
            onsets_s: vec![12.5, 40.0],
        }),
        label_probability: None,
        candidates: vec![candidate([1, 3], 0.61, 560e3), candidate([2, 5], 0.38, 120e3)],
        rejection: Some(Reason {
            code: "no-label".to_owned(),
            message: "cannot number the modes of 7 peaks: mask 13.4 Hz, or narrow the prior of axial_force_n"
                .to_owned(),
        }),
        ..snapshot(at, 0.0)
    }
}

/// `count` records `step` seconds apart; the last sixth of a year-long history loses force.
pub fn rod(id: &str, count: usize, step: i64, seed: u64) -> RodReport {
    let mut report = RodReport::new(id);
    let end = count as i64 * step;
    let onset = end - end / 6;
    let lost = |at: i64| {
        if at > onset && count > 100 {
            0.03 * (at - onset) as f64 / (end - onset) as f64
        } else {
            0.0
        }
    };
    let celsius = |at: i64, i: usize| {
        let year = 2.0 * std::f64::consts::PI * at as f64 / (365.25 * DAY as f64);
        let day = 2.0 * std::f64::consts::PI * at as f64 / DAY as f64;
        13.0 - 10.0 * year.cos() - 4.0 * day.cos() + 1.5 * noise(i, seed + 1)
    };
    for i in 0..count {
        // Three weeks of silence in summer.
        let at = i as i64 * step;
        if (170 * DAY..191 * DAY).contains(&at) {
            continue;
        }
        let temperature = celsius(at, i);
        let thermal = SLOPE * (temperature - REFERENCE);
        let truth = 1.0 - lost(at) + thermal;
        let measured = truth + 0.002 * noise(i, seed + 2);
        let learned = i >= 30;
        report.records.push(RecordPoint {
            start: time(at),
            segment: Some(1),
            force_n: interval(560e3 * truth + 22e3 * noise(i, seed + 3), 92e3),
            tracked_force_n: learned.then(|| interval(560e3 * measured, 88e3)),
            force_at_reference_n: learned.then(|| interval(560e3 * (measured - thermal), 88e3)),
            ratio: learned.then(|| interval(measured, 0.002)),
            ratio_at_reference: (i >= 40).then(|| interval(measured - thermal, 0.0025)),
            temperature_c: Some(temperature),
            reference_c: learned.then_some(REFERENCE),
            modes: [(1, 4.49, 0.45), (2, 9.28, 0.42), (3, 14.5, 0.38)]
                .map(|(order, hz, slope)| {
                    (
                        order,
                        hz * (1.0 + slope * (measured - 1.0) + 0.0005 * noise(i, seed + 3 + order as u64)),
                        0.001 * hz,
                    )
                })
                .to_vec(),
            doubts: Vec::new(),
            set_aside: None,
        });
    }
    let mut evidence = 1e-3_f64;
    let days = end / DAY;
    for day in 0..days {
        let at = day * DAY;
        if (170..191).contains(&day) {
            continue;
        }
        let i = day as usize;
        let temperature = celsius(at + DAY / 4, i);
        let thermal = SLOPE * (temperature - REFERENCE);
        let delta = thermal - lost(at) + 0.002 * noise(i, seed + 9);
        let residual = (delta - thermal) / 0.0022;
        evidence = (evidence * (0.5 * residual * residual).exp() * 0.5 + 1e-4).min(1e6);
        report.periods.push((
            1,
            Period {
                index: FIRST / DAY + day,
                start: time(at),
                began: None,
                measured: None,
                records: 1,
                delta,
                delta_sd: 0.002,
                filtered_c: Some([temperature; 6]),
                unread_k2: None,
                lagged_c: None,
                misfit: vec![],
                not_axial_p: 0.4,
                charted: (day >= 10).then_some(Charted {
                    expected: thermal,
                    expected_sd: 0.0022,
                    residual,
                    leverage: 0.03,
                    unread_sd: None,
                    at_reference: Some(delta - thermal),
                    at_reference_sd: Some(0.0022),
                    temperature_c: Some(temperature),
                    evidence: Evidence {
                        compensated: Some(evidence),
                        peers: None,
                        blind: None,
                    },
                }),
            },
        ));
    }
    report.state = Some(RodState::Monitoring);
    report.motion_unit = Some("m".to_owned());
    report.thermal = Some(ThermalLine {
        slope_per_k: SLOPE,
        slope_sd_per_k: 0.0001,
    });
    report.segments.push(SegmentReport {
        number: 1,
        reason: "first".to_owned(),
        baseline: (count >= 30).then(|| (time(0), time(29 * step))),
        records: 30,
        overdispersion: Some(1.12),
        reference_c: Some(REFERENCE),
        fault: None,
    });
    report.rejections = vec![
        RejectionCount {
            code: "no-peak".to_owned(),
            count: 4,
            last: Some(time(100 * DAY)),
            message: "no peak between 2.1 and 24.0 Hz".to_owned(),
        },
        RejectionCount {
            code: "clipped".to_owned(),
            count: 1,
            last: None,
            message: "1.20 % of the samples are clipped, at most 0.10 % allowed".to_owned(),
        },
    ];
    if count > 100 {
        report.state = Some(RodState::Alarm);
        let raised = onset + (end - onset) / 4;
        report.alarms.push(Alarm {
            witness: None,
            alternatives: None,
            id: "1a2b3c".to_owned(),
            rod: RodId(id.to_owned()),
            kind: Kind::NoData,
            raised: time(172 * DAY),
            message: "no usable record since 2025-06-28T00:00:00Z".to_owned(),
            change: None,
            acknowledged: None,
            cleared: Some(time(191 * DAY)),
            told: time(172 * DAY),
        });
        report.alarms.push(Alarm {
            witness: None,
            alternatives: None,
            id: "4d5e6f".to_owned(),
            rod: RodId(id.to_owned()),
            kind: Kind::Drift,
            raised: time(raised),
            message: "the force falls: \u{2212}0.8 % since about 2025-11-10".to_owned(),
            change: Some(Change {
                onset: time(onset),
                onset_q025: time(onset - (end - onset) / 8),
                onset_q975: time(onset + (end - onset) / 6),
                size: interval(-0.008, 0.001),
                rate_per_year: interval(-0.18, 0.02),
                step_probability: 0.1,
            }),
            acknowledged: None,
            cleared: None,
            told: time(raised),
        });
    }
    report.baseline = Some(snapshot(time(0), 0.0));
    report.latest = Some(snapshot(time(end - step), -0.02));
    report
}

/// Two rods, a year of days.
pub fn site() -> SiteReport {
    let mut quiet = rod("south", 60, DAY, 20);
    quiet.rejections.clear();
    SiteReport {
        site: "San Fortunato, Todi".to_owned(),
        rods: vec![rod("north", 365, DAY, 10), quiet],
        provenance: vec![
            ("program".to_owned(), "tirante 0.1.0".to_owned()),
            ("configuration".to_owned(), "0123456789abcdef".to_owned()),
            ("analysis version".to_owned(), "1".to_owned()),
        ],
    }
}
