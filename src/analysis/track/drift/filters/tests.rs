//! Filters against closed forms, fine integrations and simulated air.

use super::*;
use crate::numerics::random;
use rand_distr::{Distribution, StandardNormal};

#[test]
fn filters_agree_with_a_fine_integration() {
    let points = [
        (0.0, 10.0),
        (0.05, 14.0),
        (0.07, 9.0),
        (0.5, 9.5),
        (0.5001, 20.0),
        (1.4, 3.0),
    ];
    let mut filters = Filters::default();
    points
        .iter()
        .for_each(|&(day, celsius)| filters.push(day, celsius));
    let end = 1.4;
    let found = filters.at(end).unwrap();
    assert_eq!(found[0], 3.0);
    for (memory_d, found) in FILTERS_D.into_iter().zip(found).skip(1) {
        // Midpoint rule in steps of 5e-6 d: errors of (h / memory)^2 / 24 of the swings.
        let (mut value, h) = (10.0, 5e-6);
        for step in 0..280_000 {
            let t = (f64::from(step) + 0.5) * h;
            let air = points.windows(2).find(|pair| t < pair[1].0).map_or(3.0, |pair| {
                pair[0].1 + (t - pair[0].0) / (pair[1].0 - pair[0].0) * (pair[1].1 - pair[0].1)
            });
            let slope = (air - value) / memory_d;
            value += h * (air - (value + 0.5 * h * slope)) / memory_d;
        }
        assert!((value - found).abs() < 1e-6, "{memory_d}: {value} {found}");
    }
}

#[test]
fn a_trend_goes_on_and_dies_away() {
    let mut filters = Filters::default();
    // 1 K an hour for two days: the low pass of two hours lags by them to e^-24.
    for hour in 0..=48 {
        filters.push(f64::from(hour) / 24.0, f64::from(hour));
    }
    let [air, six_hours, ..] = filters.at(2.0 + 0.5 / 24.0).unwrap();
    let ahead_k = 4.0 * (1.0 - (-0.125_f64).exp());
    assert!((air - 48.0 - ahead_k).abs() < 1e-9, "{air}");
    let (x, behind) = (0.5 / 6.0_f64, 6.0 * (1.0 - (-8.0_f64).exp()));
    let expected = air - behind * (-x).exp() - ahead_k * (1.0 - (-x).exp()) / x;
    assert!((six_hours - expected).abs() < 1e-9, "{six_hours} {expected}");
    // A state of an earlier version has no trend until it has seen some hours.
    let mut earlier = Filters {
        trailing: None,
        ..filters
    };
    assert_eq!(earlier.at(2.02).unwrap()[0], 48.0);
    earlier.push(2.0 + 1.0 / 24.0, 49.0);
    assert_eq!(earlier.at(2.05).unwrap()[0], 49.0);
}

/// Days of 6 K and readings every hour in digits of 0.1 K: the air within an hour of the last reading, at any time of day.
#[test]
fn a_trend_misses_less_of_the_air_than_holding() {
    let air = |day: f64| 3.0 * (std::f64::consts::TAU * day).sin();
    let mut filters = Filters::default();
    let (mut missed, mut held, mut stated) = (0.0, 0.0, 0.0);
    for hour in 0..24 * 10 {
        let read = f64::from(hour) / 24.0;
        let celsius = (air(read) * 10.0).round() / 10.0;
        filters.push(read, celsius);
        for minute in [15.0, 30.0, 45.0, 60.0] {
            let day = read + minute / 1440.0;
            if day > 2.0 {
                missed += (filters.at(day).unwrap()[0] - air(day)).powi(2);
                held += (celsius - air(day)).powi(2);
                stated += filters.unread_k2(day).unwrap()[0][0];
            }
        }
    }
    // 0.32 by another program; the low pass is late by two hours at the turns of the day.
    assert!(missed < 0.4 * held, "{}", missed / held);
    // Beside the slope, its change is missed too, which counts less within the hour than at its end.
    let ratio = stated / missed;
    assert!((0.9..1.4).contains(&ratio), "{ratio}");
}

#[test]
fn between_dense_readings_the_air_is_on_the_line() {
    let mut filters = Filters::default();
    for hour in 0..48 {
        filters.push(f64::from(hour) / 24.0, f64::from(hour % 5));
    }
    let (last, next) = (47.0 / 24.0, (2.0, 6.0));
    let at = last + 0.25 / 24.0;
    let mut read = filters.clone();
    read.push(at, 3.0);
    let found = filters.before(next, at).unwrap();
    for (found, read) in found.iter().zip(read.at(at).unwrap()) {
        assert!((found - read).abs() < 1e-12, "{found} {read}");
    }
    assert_eq!(filters.before(next, 2.01), None);
    assert_eq!(filters.before((2.5, 6.0), at), None);
    let mut sparse = Filters::default();
    (0..9).for_each(|day| sparse.push(f64::from(day), 10.0));
    assert_eq!(sparse.before((9.0, 12.0), 8.5), None);
}

#[test]
fn readings_out_of_turn_are_left_out_and_holes_start_anew() {
    let mut filters = Filters::default();
    assert_eq!(filters.at(0.0), None);
    for hour in 0..48 {
        filters.push(f64::from(hour) / 24.0, 10.0);
    }
    let before = filters.clone();
    for (day, celsius) in [(1.0, 50.0), (47.0 / 24.0, 50.0), (3.0, f64::NAN), (f64::NAN, 1.0)] {
        filters.push(day, celsius);
    }
    assert_eq!(filters, before);
    assert!(!filters.is_sparse() && filters.at(2.05).is_some() && filters.at(2.2).is_none());
    // Ten days: one day and three days are forgotten, ten and thirty are not.
    filters.push(12.0, 20.0);
    let found = filters.at(12.0).unwrap();
    assert!(found[..4].iter().all(|&celsius| celsius == 20.0), "{found:?}");
    assert!(found[4..].iter().all(|&celsius| celsius < 15.0), "{found:?}");
}

/// Hourly readings of air with a daily cycle, weather and a season, and holes of two to forty days: what the filters miss after one.
#[test]
fn holes_leave_open_where_the_filters_are() {
    let mut generator = random::stream(31, 0);
    let keep = libm::exp(-1.0 / 72.0_f64);
    let (mut weather, mut filters, mut whole) = (0.0, Filters::default(), Filters::default());
    let (mut missed, mut stated) = ([0.0; FILTERS_D.len()], [0.0; FILTERS_D.len()]);
    let mut looks = 0;
    for hour in 0..24 * 20_000 {
        let kick: f64 = StandardNormal.sample(&mut generator);
        weather = keep * weather + 2.5 * libm::sqrt(1.0 - keep * keep) * kick;
        let day = f64::from(hour) / 24.0;
        let phase = |period: f64| libm::sin(std::f64::consts::TAU * day / period);
        let celsius = weather + 3.0 * phase(1.0) + 7.0 * phase(365.25);
        whole.push(day, celsius);
        // A hole each hundred days, none in the first 300; its length goes round.
        let [number, within] = [hour / 2400, hour % 2400];
        let hole = [48, 5 * 24 + 7, 12 * 24 + 13, 40 * 24 + 5][number as usize % 4];
        if number < 3 || within >= hole {
            filters.push(day, celsius);
        }
        if number >= 3 && [0, 6, 24].contains(&(within - hole)) {
            looks += 1;
            let (truth, known) = (whole.at(day).unwrap(), filters.at(day).unwrap());
            let cov = filters.unread_k2(day).unwrap();
            for at in 0..FILTERS_D.len() {
                missed[at] += (truth[at] - known[at]).powi(2);
                stated[at] += cov[at][at];
            }
        }
        if number >= 3 && within == hole + 24 {
            assert!(!filters.is_sparse(), "a hole is not the usual gap");
        }
    }
    for at in 1..FILTERS_D.len() {
        let ratio = (stated[at] / missed[at]).sqrt();
        // A straight line through a hole knows the season, which is much of V for the slow ones.
        assert!((0.7..2.5).contains(&ratio), "{at}: {ratio} of {looks}");
    }
    assert!(filters.lost_k2[1] == 0.0 && filters.known(20_000.0, None).is_some());
}

#[test]
fn one_reading_a_day_holds_on_for_a_day() {
    let mut filters = Filters::default();
    for day in 0..20 {
        filters.push(f64::from(day), 10.0 + f64::from(day % 3));
    }
    assert!(filters.is_sparse());
    assert!(filters.at(20.4).is_some() && filters.at(20.6).is_none());
}

/// Air of three days' memory, read every three or four days: what the filters miss a day after a reading, by a simulation of the air in
/// steps of an hour.
#[test]
fn readings_leave_open_what_the_air_does_after_them() {
    let mut generator = random::stream(8, 0);
    let keep = libm::exp(-1.0 / 72.0_f64);
    let (mut air, mut filters) = (0.0, Filters::default());
    let mut followed = [0.0; FILTERS_D.len()];
    let (mut read, mut taken) = (0, 0);
    let (mut missed, mut stated) = ([0.0; FILTERS_D.len()], [0.0; FILTERS_D.len()]);
    for hour in 0..24 * 3000 {
        let kick: f64 = StandardNormal.sample(&mut generator);
        let before = air;
        air = keep * air + 2.5 * libm::sqrt(1.0 - keep * keep) * kick;
        for (followed, memory_d) in followed.iter_mut().zip(FILTERS_D) {
            *followed = follow(*followed, before, air, 1.0 / 24.0, memory_d);
        }
        let day = f64::from(hour) / 24.0;
        if hour == read {
            filters.push(day, air);
            read += if read % 168 == 0 { 72 } else { 96 };
        }
        let is_a_day_later = filters
            .last_day()
            .is_some_and(|last| (day - last - 1.0).abs() < 1e-9);
        if day > 300.0 && is_a_day_later {
            let held = filters.at(day).unwrap();
            let unread_k2 = filters.unread_k2(day).unwrap();
            taken += 1;
            for at in 0..FILTERS_D.len() {
                missed[at] += (followed[at] - held[at]).powi(2);
                stated[at] += unread_k2[at][at];
            }
        }
    }
    // The slower filters miss more by the straight line between readings, which is noise of every period.
    for at in 0..2 {
        let ratio = (stated[at] / missed[at]).sqrt();
        assert!((0.8..1.25).contains(&ratio), "{at}: {ratio} of {taken}");
    }
}
