//! The usual distance in time between records: what a silence is measured by.

use crate::signal::record::Timestamp;

/// Share of the distances that are no pause.
const NO_PAUSE: f64 = 0.9;

/// The usual distance between records, ascending in time \[s\]: their mean, or what nine of ten do not exceed where that is less, since one
/// pause would make the mean of hourly records one of days. `None` of fewer than two.
pub fn usual_s(times: impl Iterator<Item = Timestamp> + Clone) -> Option<f64> {
    let mut distances: Vec<f64> = (times.clone().skip(1).zip(times))
        .map(|(later, earlier)| later.seconds_since(earlier))
        .collect();
    distances.sort_by(f64::total_cmp);
    let count = distances.len();
    let place = (NO_PAUSE * count as f64).ceil() as usize;
    let most = distances.get(place.saturating_sub(1))?;
    let mean = distances.iter().sum::<f64>() / count as f64;
    Some(mean.min(*most))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR_S: f64 = 3600.0;

    fn of(hours: &[f64]) -> Option<f64> {
        let times = hours
            .iter()
            .map(|hour| Timestamp::from_nanos(0).plus_seconds(hour * HOUR_S));
        Some(usual_s(times)? / HOUR_S)
    }

    #[test]
    fn one_pause_of_a_season_does_not_make_hourly_records_rare() {
        let mut hours: Vec<f64> = (0..30).map(f64::from).collect();
        assert_eq!(of(&hours), Some(1.0));
        hours[20..].iter_mut().for_each(|hour| *hour += 80.0 * 24.0);
        assert_eq!(of(&hours), Some(1.0));
    }

    #[test]
    fn rounds_of_some_records_are_as_far_apart_as_their_mean() {
        let round = |round: u32| (0..3).map(move |record| f64::from(round) * 336.0 + 0.1 * f64::from(record));
        let hours: Vec<f64> = (0..10).flat_map(round).collect();
        let usual = of(&hours).unwrap();
        assert!(3.5 * usual > 336.0, "{usual}");
        assert_eq!(of(&hours[..4]), Some(336.0 / 3.0));
        assert_eq!((of(&hours[..1]), of(&[])), (None, None));
    }
}
