//! Air temperature through the seasons, and the rod temperature that lags behind it.

use super::oscillator::normal;
use super::settings::Climate;
use crate::numerics::random;
use crate::signal::record::Timestamp;
use crate::signal::record::time::DAY_S;
use std::f64::consts::PI;

const HOUR: f64 = 3600.0;
/// The tropical year \[s\].
const YEAR: f64 = 365.242_19 * DAY_S;
/// Step of the weather's grid \[s\].
const STEP: f64 = 600.0;
/// Time before the first sample at which the weather begins \[s\], so that the slowest rod has forgotten
/// its start.
const WARM_UP: f64 = 30.0 * DAY_S;

/// A temperature history of one site.
#[derive(Debug, Clone)]
pub struct Weather {
    climate: Climate,
    start: Timestamp,
    /// The random part of the air temperature \[K\], every [`STEP`] from [`WARM_UP`] before the start.
    random: Vec<f64>,
}

/// The random part of a rod's temperature, on the grid of the weather.
#[derive(Debug, Clone)]
pub struct Lagged {
    lag_s: f64,
    random: Vec<f64>,
}

impl Weather {
    /// The history of `duration_s` from `start`; the same seed gives the same weather.
    pub fn new(climate: &Climate, start: Timestamp, duration_s: f64, seed: u64) -> Self {
        let points = ((WARM_UP + duration_s.max(0.0)) / STEP).ceil() as usize + 2;
        let memory = libm::exp(-STEP / (climate.weather_d * DAY_S));
        let innovation = climate.weather_k * (1.0 - memory * memory).sqrt();
        let mut generator = random::stream(seed, 0);
        let mut value = climate.weather_k * normal(&mut generator);
        let random = (0..points)
            .map(|_| {
                let now = value;
                value = memory * value + innovation * normal(&mut generator);
                now
            })
            .collect();
        Self {
            climate: *climate,
            start,
            random,
        }
    }

    /// Response of a rod of time constant `lag_h` \[h\] to the random part: T' = (T_air - T) / lag,
    /// exact for an air temperature constant over each ten minutes.
    pub fn lagged(&self, lag_h: f64) -> Lagged {
        let lag_s = lag_h * HOUR;
        let gain = if lag_s > 0.0 {
            1.0 - libm::exp(-STEP / lag_s)
        } else {
            1.0
        };
        let mut value = self.random.first().copied().unwrap_or(0.0);
        let random = self
            .random
            .iter()
            .map(|air| {
                value += gain * (air - value);
                value
            })
            .collect();
        Lagged { lag_s, random }
    }

    /// Temperature of the air \[degC\].
    pub fn air_c(&self, time: Timestamp) -> f64 {
        self.cosines(time, 0.0) + self.interpolated(&self.random, time)
    }

    /// Temperature of a rod that follows the air late \[degC\].
    pub fn rod_c(&self, lagged: &Lagged, time: Timestamp) -> f64 {
        self.cosines(time, lagged.lag_s) + self.interpolated(&lagged.random, time)
    }

    /// Mean, season and day behind a first-order lag: each cosine loses sqrt(1 + (omega lag)^2) of its
    /// amplitude and atan(omega lag) of its phase.
    fn cosines(&self, time: Timestamp, lag_s: f64) -> f64 {
        let since_epoch = time.as_nanos() as f64 * 1e-9;
        let cosine = |amplitude: f64, period: f64, maximum: f64| {
            let omega = 2.0 * PI / period;
            let delay = omega * lag_s;
            let angle = omega * (since_epoch - maximum) - libm::atan(delay);
            amplitude / (1.0 + delay * delay).sqrt() * libm::cos(angle)
        };
        let climate = &self.climate;
        // Day 1 of a year is the first of January, 1970 as good as any.
        climate.mean_c
            + cosine(climate.season_k, YEAR, (climate.warmest_day - 1.0) * DAY_S)
            + cosine(climate.day_k, DAY_S, climate.warmest_hour * HOUR)
    }

    fn interpolated(&self, grid: &[f64], time: Timestamp) -> f64 {
        let place = ((time.seconds_since(self.start) + WARM_UP) / STEP).clamp(0.0, (grid.len() - 1) as f64);
        let i = (place as usize).min(grid.len() - 2);
        let share = place - i as f64;
        grid[i] * (1.0 - share) + grid[i + 1] * share
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLIMATE: Climate = Climate {
        mean_c: 14.0,
        season_k: 8.0,
        warmest_day: 205.0,
        day_k: 3.0,
        warmest_hour: 14.0,
        weather_k: 0.0,
        weather_d: 3.0,
        noise_k: 0.0,
        every_s: 10.0,
        between_s: None,
    };

    fn at(text: &str) -> Timestamp {
        Timestamp::from_nanos(text.parse::<jiff::Timestamp>().unwrap().as_nanosecond() as i64)
    }

    #[test]
    fn the_warmest_hour_is_a_summer_afternoon() {
        let start = at("2025-01-01T00:00:00Z");
        let weather = Weather::new(&CLIMATE, start, 400.0 * DAY_S, 1);
        let warmest = (0..400 * 24)
            .map(|hour| start.plus_seconds(f64::from(hour) * HOUR))
            .max_by(|a, b| weather.air_c(*a).total_cmp(&weather.air_c(*b)))
            .unwrap();
        // The year's phase drifts by up to a day within four years; so may the day.
        let day = warmest.seconds_since(start) / DAY_S;
        assert!((day - 204.6).abs() < 1.6, "{warmest}");
        assert!(warmest.to_string().contains("T14:00"), "{warmest}");
        assert!((weather.air_c(warmest) - 25.0).abs() < 0.01);
    }

    #[test]
    fn a_rod_follows_the_air_as_the_equation_of_heat_says() {
        // Oracle: T' = (T_air - T) / lag by small explicit steps, with weather.
        let climate = Climate {
            weather_k: 3.0,
            ..CLIMATE
        };
        let start = at("2025-03-01T00:00:00Z");
        let weather = Weather::new(&climate, start, 20.0 * DAY_S, 5);
        let lag_h = 5.0;
        let lagged = weather.lagged(lag_h);
        let step = 20.0;
        let mut rod = weather.rod_c(&lagged, start);
        for i in 0..(10.0 * DAY_S / step) as usize {
            let now = start.plus_seconds(i as f64 * step);
            let exact = weather.rod_c(&lagged, now);
            // The weather is a staircase of 10 min there, a polygon here: a few hundredths of a kelvin.
            assert!((rod - exact).abs() < 0.1, "{now}: {rod} {exact}");
            rod += step / (lag_h * HOUR) * (weather.air_c(now) - rod);
        }
    }

    #[test]
    fn weather_has_the_variance_and_memory_asked_for() {
        let climate = Climate {
            season_k: 0.0,
            day_k: 0.0,
            weather_k: 2.0,
            weather_d: 0.5,
            ..CLIMATE
        };
        let start = at("2025-01-01T00:00:00Z");
        let days = 4000.0;
        let weather = Weather::new(&climate, start, days * DAY_S, 3);
        let series: Vec<f64> = (0..8000)
            .map(|i| weather.air_c(start.plus_seconds(i as f64 * 0.5 * DAY_S)) - climate.mean_c)
            .collect();
        let n = series.len() as f64;
        let variance = series.iter().map(|x| x * x).sum::<f64>() / n;
        let next: f64 = series.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>() / n;
        // About 6000 independent values: sd of the variance 2 %, of the correlation 1 %.
        assert!((variance / 4.0 - 1.0).abs() < 0.08, "{variance}");
        assert!(
            (next / variance - (-1.0f64).exp()).abs() < 0.05,
            "{}",
            next / variance
        );
    }
}
