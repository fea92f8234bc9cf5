//! Tests of the findings on a record.

use super::*;

#[test]
fn an_interval_without_an_order_of_magnitude_is_a_doubt() {
    for (interval, is) in [
        ([1.0, 9.9], false),
        ([1.0, 10.1], true),
        ([-1.0, 9.0], true),
        ([0.0, 9.0], true),
        ([-9.0, -1.0], false),
        ([-11.0, -1.0], true),
        ([f64::NAN, 1.0], false),
    ] {
        assert_eq!(is_wide(interval), is, "{interval:?}");
    }
    let wide = Doubt::all(Some(0.0), Some(0.5), Some(1.0), Some([1e3, 1e6]));
    assert_eq!((&wide[..], Doubt::mark(&wide)), (&[Doubt::Wide][..], "? "));
    let both = Doubt::all(Some(4.0), None, Some(0.5), Some([1e3, 1e6]));
    assert_eq!(both, [Doubt::Conflict, Doubt::Orders, Doubt::Wide]);
    assert_eq!(Doubt::mark(&both), "! ");
}

fn resonance(frequency_hz: f64, damping: f64, line: bool) -> Resonance {
    Resonance {
        frequency_hz,
        frequency_sd_hz: 1e-3,
        damping,
        damping_log_sd: 0.1,
        peak_to_noise: 1000.0,
        evidence: 100.0,
        line,
        misfit: 0.0,
        foreign_log_odds: 0.0,
    }
}

#[test]
fn a_peak_is_taken_for_what_its_shape_and_neighbours_say() {
    let resonances = [
        resonance(0.3, 0.2, false),
        resonance(4.492, 0.002, false),
        resonance(8.984, 0.002, false),
        resonance(9.288, 0.002, false),
        resonance(30.0, 0.2, false),
        resonance(50.0, 1e-5, true),
        resonance(150.0, 1e-5, true),
        Resonance {
            foreign_log_odds: 3.0,
            ..resonance(170.3, 0.002, false)
        },
    ];
    let mode = Mode {
        order: 2,
        frequency_hz: 9.288,
        sd_hz: 1e-3,
        damping: None,
    };
    let found = of_resonances(&resonances, &[mode], 0.05, 60.0);
    let said: Vec<String> = found
        .iter()
        .map(|peak| said(peak.taken_for, peak.order, peak.multiple_of))
        .collect();
    assert_eq!(
        said,
        [
            "drift",
            "candidate",
            "candidate, 2 x 4.492",
            "mode 2",
            "broad",
            "tone",
            "harmonic, 3 x 50.000",
            "doubtful"
        ]
    );
    assert_eq!(found[0].level_db, 30.0);
}

#[test]
fn a_mode_beside_another_peak_is_the_nearest_one() {
    let resonances = [resonance(9.27, 0.002, false), resonance(9.29, 0.002, false)];
    let mode = Mode {
        order: 1,
        frequency_hz: 9.29,
        sd_hz: 1e-3,
        damping: None,
    };
    let orders: Vec<Option<usize>> = of_resonances(&resonances, &[mode], 0.05, 60.0)
        .iter()
        .map(|peak| peak.order)
        .collect();
    assert_eq!(orders, [None, Some(1)]);
}

#[test]
fn a_motion_is_said_in_words() {
    let said = |kind, onsets_s: &[f64]| {
        motion_said(&Motion {
            kind,
            onsets_s: onsets_s.to_vec(),
        })
    };
    assert_eq!(said(MotionKind::Ambient, &[]), "ambient vibration");
    assert_eq!(said(MotionKind::FreeDecay, &[2.314]), "a free decay from 2.31 s");
    assert_eq!(
        said(MotionKind::Blow, &[1.0, 2.0, 3.0, 4.0, 5.0]),
        "ambient vibration with blows at 1.00, 2.00, 3.00, 4.00 s and 1 more"
    );
}
