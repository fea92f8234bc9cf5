//! Onset, size and rate of a change, with credible intervals.
//!
//! The regression's line with one more column: e^delta_t - 1 = a + beta (T - T_ref) + c shape(t) + q_t e_t, where the
//! shape is a step or a ramp that goes on, one at the last period, from an onset anywhere in the series. For a given
//! onset and shape c is Student's t (flat priors for a, beta and ln of the noise, c ~ N(0, 0.1^2)); the posterior is
//! the sum over all onsets, uniform in time beforehand (from the first period that could tell), and both shapes, equally likely beforehand. The noise is whitened
//! by the given AR(1) coefficient. Sums over the periods after an onset are suffix sums, so that the whole posterior costs
//! a time in proportion to the periods.

use super::relative::Interval;
use super::tail;
use crate::record::Timestamp;
use serde::{Deserialize, Serialize};

/// Fewer periods say nothing.
const FEW: usize = 8;
/// Prior standard deviation of the size \[-\].
const SIZE_SD: f64 = 0.1;
/// Weights below do not count.
const NEGLIGIBLE: f64 = 1e-6;
/// Onsets of a ramp tried within a period.
const WITHIN: usize = 8;
const YEAR_S: f64 = 365.25 * 86_400.0;

/// One period of the series searched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Its beginning.
    pub start: Timestamp,
    /// delta.
    pub delta: f64,
    /// Low-passed temperature less the reference \[K\]; zero without compensation.
    pub warmer_k: f64,
}

/// What is known about a change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Median of the onset's posterior.
    pub onset: Timestamp,
    /// 95 % interval of the onset.
    pub onset_q025: Timestamp,
    /// 95 % interval of the onset.
    pub onset_q975: Timestamp,
    /// Relative change of force up to the last period, as a share of N_0 \[-\].
    pub size: Interval,
    /// Relative change per year while it lasts, if it is a ramp \[1/year\].
    pub rate_per_year: Interval,
    /// Probability that it is a step rather than a ramp.
    pub step_probability: f64,
}

/// The whitened columns of one period: intercept, temperature, time and response.
#[derive(Debug, Clone, Copy, Default)]
struct Columns {
    one: f64,
    warmer: f64,
    time: f64,
    response: f64,
    /// What a shape that is one here and was zero before contributes.
    first: f64,
}

/// Products of the columns summed from a period to the last.
#[derive(Debug, Clone, Copy, Default)]
struct Products {
    one_one: f64,
    one_warmer: f64,
    one_response: f64,
    time_one: f64,
    time_warmer: f64,
    time_response: f64,
    time_time: f64,
}

/// The posterior given onset and shape.
#[derive(Debug, Clone, Copy)]
struct Part {
    weight: f64,
    step: bool,
    /// The change began between the middles of periods `cell - 1` and `cell`.
    cell: usize,
    /// Length of the ramp as a share of the span.
    length: f64,
    size: f64,
    scale: f64,
}

/// The two columns that are always there, orthogonalised.
struct Base {
    one_one: f64,
    /// Share of the first column in the second.
    slant: f64,
    /// Squared norm of what is left of the second; `None` if it is nothing.
    rest: Option<f64>,
}

impl Base {
    /// <v, w> less what the base explains, from the products of v and w with the base's columns.
    fn residual(&self, product: f64, v: [f64; 2], w: [f64; 2]) -> f64 {
        let first = v[0] * w[0] / self.one_one;
        let second = self.rest.map_or(0.0, |rest| {
            (v[1] - self.slant * v[0]) * (w[1] - self.slant * w[0]) / rest
        });
        product - first - second
    }
}

/// Finds the change in a series in time order, with an onset not before the sample number `earliest`;
/// `autocorrelation` is that between neighbours. `None` if there are too few periods (eight), or they do not ascend or are not
/// finite.
pub fn estimate(series: &[Sample], earliest: usize, autocorrelation: f64) -> Option<Change> {
    let finite = |sample: &Sample| sample.delta.is_finite() && sample.warmer_k.is_finite();
    let ascending = series.windows(2).all(|pair| pair[0].start < pair[1].start);
    let (first, last) = (series.first()?, series.last()?);
    if series.len() < FEW || !ascending || !series.iter().all(finite) || !autocorrelation.is_finite() {
        return None;
    }
    let spacing_s = series
        .windows(2)
        .map(|pair| pair[1].start.seconds_since(pair[0].start))
        .fold(f64::INFINITY, f64::min);
    let span_s = last.start.seconds_since(first.start);
    let columns = columns(series, autocorrelation.clamp(-0.9, 0.99), spacing_s);
    let share = |index: usize| {
        series
            .get(index)
            .map_or(0.0, |s| s.start.seconds_since(first.start) / span_s)
    };
    let parts = posterior(&columns, earliest, share)?;

    let middle = first.start.plus_seconds(0.5 * spacing_s);
    let onset = |probability: f64| middle.plus_seconds(span_s * onset_quantile(&parts, share, probability));
    let sizes: Vec<Part> = parts
        .iter()
        .copied()
        .filter(|part| part.weight > NEGLIGIBLE)
        .collect();
    let ramp_weight: f64 = parts
        .iter()
        .filter(|part| !part.step)
        .map(|part| part.weight)
        .sum();
    let rates: Vec<Part> = parts
        .iter()
        .filter(|part| !part.step && part.weight > NEGLIGIBLE * ramp_weight)
        .map(|part| {
            let years = part.length * span_s / YEAR_S;
            Part {
                weight: part.weight / ramp_weight,
                size: part.size / years,
                scale: part.scale / years,
                ..*part
            }
        })
        .collect();
    let freedom = (series.len() - 2) as f64;
    Some(Change {
        onset: onset(0.5),
        onset_q025: onset(0.025),
        onset_q975: onset(0.975),
        size: interval(&sizes, freedom),
        rate_per_year: interval(&rates, freedom),
        step_probability: (1.0 - ramp_weight).clamp(0.0, 1.0),
    })
}

fn columns(series: &[Sample], autocorrelation: f64, spacing_s: f64) -> Vec<Columns> {
    let (Some(first), Some(last)) = (series.first(), series.last()) else {
        return Vec::new();
    };
    let span_s = last.start.seconds_since(first.start);
    let mean_warmer = series.iter().map(|sample| sample.warmer_k).sum::<f64>() / series.len() as f64;
    let mut before: Option<(Timestamp, Columns)> = None;
    let whiten = |sample: &Sample| {
        let delta = sample.delta.clamp(-20.0, 20.0);
        // An error of the logarithm is an error in proportion to the force.
        let level = libm::exp(delta).clamp(0.2, 5.0);
        let plain = Columns {
            one: 1.0 / level,
            warmer: (sample.warmer_k - mean_warmer) / level,
            time: sample.start.seconds_since(first.start) / span_s / level,
            response: libm::expm1(delta) / level,
            first: 1.0 / level,
        };
        let (rho, then) = before.map_or((0.0, Columns::default()), |(start, then)| {
            let gap = (sample.start.seconds_since(start) / spacing_s)
                .round()
                .clamp(1.0, 1e6);
            (autocorrelation.powi(gap as i32), then)
        });
        before = Some((sample.start, plain));
        let white = (1.0 - rho * rho).sqrt();
        Columns {
            one: (plain.one - rho * then.one) / white,
            warmer: (plain.warmer - rho * then.warmer) / white,
            time: (plain.time - rho * then.time) / white,
            response: (plain.response - rho * then.response) / white,
            first: plain.first / white,
        }
    };
    series.iter().map(whiten).collect()
}

/// The posterior over onsets from the period `earliest` on and shapes. `share` is a period's place in the span, 0 to 1.
fn posterior(columns: &[Columns], earliest: usize, share: impl Fn(usize) -> f64) -> Option<Vec<Part>> {
    let sum = |f: fn(&Columns) -> f64| columns.iter().map(f).sum::<f64>();
    let one_one = sum(|c| c.one * c.one);
    let one_warmer = sum(|c| c.one * c.warmer);
    let warmer_warmer = sum(|c| c.warmer * c.warmer);
    let rest = warmer_warmer - one_warmer * one_warmer / one_one;
    let base = Base {
        one_one,
        slant: one_warmer / one_one,
        rest: (rest > 1e-9 * warmer_warmer && rest > 0.0).then_some(rest),
    };
    let on_response = [sum(|c| c.one * c.response), sum(|c| c.warmer * c.response)];
    let squares = base
        .residual(sum(|c| c.response * c.response), on_response, on_response)
        .max(1e-24);
    let freedom = (columns.len() - 2) as f64;

    let mut after = Products::default();
    // Size estimate and information of every onset and shape, the last onset first.
    let mut found = Vec::with_capacity((1 + WITHIN) * columns.len());
    for (cell, at) in columns.iter().enumerate().skip(earliest.max(1)).rev() {
        let (low, high) = (share(cell - 1), share(cell));
        let width = high - low;
        let mut take = |step: bool, length: f64, head: f64, tail: [f64; 4], prior: f64| {
            // Scaled to one at the last period.
            let [one, warmer, response, norm] = tail;
            let on_base = [
                (one + head * at.one) / length,
                (warmer + head * at.warmer) / length,
            ];
            let response = (response + head * at.response) / length;
            let norm = (norm + head * head) / (length * length);
            let information = base.residual(norm, on_base, on_base);
            let product = base.residual(response, on_base, on_response);
            if information > 1e-9 * norm {
                found.push((step, cell, length, prior, information, product));
            }
        };
        let tail = [after.one_one, after.one_warmer, after.one_response, after.one_one];
        take(true, 1.0, at.first, tail, width);
        for part in 0..WITHIN {
            // A steep ramp tells its onset to a fraction of a period.
            let begin = low + width * (part as f64 + 0.5) / WITHIN as f64;
            let tail = [
                after.time_one - begin * after.one_one,
                after.time_warmer - begin * after.one_warmer,
                after.time_response - begin * after.one_response,
                after.time_time - 2.0 * begin * after.time_one + begin * begin * after.one_one,
            ];
            let head = (high - begin) * at.first;
            take(false, 1.0 - begin, head, tail, width / WITHIN as f64);
        }
        after.one_one += at.one * at.one;
        after.one_warmer += at.one * at.warmer;
        after.one_response += at.one * at.response;
        after.time_one += at.time * at.one;
        after.time_warmer += at.time * at.warmer;
        after.time_response += at.time * at.response;
        after.time_time += at.time * at.time;
    }
    // The size's prior variance over the noise's, from the best onset's noise.
    let best = found.iter().map(|f| f.5 * f.5 / f.4).fold(0.0, f64::max);
    let noise = (squares - best).max(1e-12 * squares) / freedom;
    let precision = noise / (SIZE_SD * SIZE_SD);
    let mut parts: Vec<(f64, Part)> = found
        .into_iter()
        .map(|(step, cell, length, prior, information, product)| {
            let total = information + precision;
            let left = (squares - product * product / total).max(1e-12 * squares);
            let ln_weight = libm::log(prior)
                - 0.5 * libm::log(total / precision)
                - 0.5 * freedom * libm::log(left / squares);
            let part = Part {
                weight: 0.0,
                step,
                cell,
                length,
                size: product / total,
                scale: (left / freedom / total).sqrt(),
            };
            (ln_weight, part)
        })
        .collect();
    let highest = parts.iter().map(|part| part.0).fold(f64::NEG_INFINITY, f64::max);
    if !highest.is_finite() {
        return None;
    }
    let sum: f64 = parts.iter().map(|part| libm::exp(part.0 - highest)).sum();
    for (ln_weight, part) in &mut parts {
        part.weight = libm::exp(*ln_weight - highest) / sum;
    }
    let mut parts: Vec<Part> = parts.into_iter().map(|(_, part)| part).collect();
    parts.reverse();
    Some(parts)
}

/// Where in the span, from 0 to 1, the onset's distribution function reaches a probability.
fn onset_quantile(parts: &[Part], share: impl Fn(usize) -> f64, probability: f64) -> f64 {
    let mut reached = 0.0;
    for part in parts {
        if reached + part.weight >= probability && part.weight > 0.0 {
            // Both shapes of a cell follow one another: within a cell the onset is uniform.
            let cell: f64 = parts
                .iter()
                .filter(|p| p.cell == part.cell)
                .map(|p| p.weight)
                .sum();
            let before: f64 = parts
                .iter()
                .filter(|p| p.cell < part.cell)
                .map(|p| p.weight)
                .sum();
            let (low, high) = (share(part.cell - 1), share(part.cell));
            return low + (high - low) * ((probability - before) / cell).clamp(0.0, 1.0);
        }
        reached += part.weight;
    }
    1.0
}

/// Moments and 95 % interval of a mixture of Student's t laws.
fn interval(parts: &[Part], freedom: f64) -> Interval {
    let heavy = freedom / (freedom - 2.0);
    let sum: f64 = parts.iter().map(|part| part.weight).sum();
    let mean = parts.iter().map(|part| part.weight * part.size).sum::<f64>() / sum;
    let variance = parts
        .iter()
        .map(|part| part.weight * (heavy * part.scale * part.scale + (part.size - mean).powi(2)))
        .sum::<f64>()
        / sum;
    let quantile = |probability: f64| {
        let below = |x: f64| {
            let phi = |z: f64| 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
            let one =
                |part: &Part| part.weight * phi(tail::student_deviate((x - part.size) / part.scale, freedom));
            parts.iter().map(one).sum::<f64>() / sum
        };
        let bounds = parts
            .iter()
            .map(|part| (part.size - 8.0 * part.scale, part.size + 8.0 * part.scale));
        let (mut low, mut high) = bounds.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (a, b)| {
            (low.min(a), high.max(b))
        });
        for _ in 0..40 {
            let x = 0.5 * (low + high);
            if below(x) < probability { low = x } else { high = x }
        }
        0.5 * (low + high)
    };
    Interval {
        mean,
        sd: variance.sqrt(),
        q025: quantile(0.025),
        q975: quantile(0.975),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random;
    use rand_distr::{Distribution, StandardNormal};

    const DAY_S: f64 = 86_400.0;
    const NOISE: f64 = 0.003;
    const BETA: f64 = -0.006;

    struct Truth {
        onset: Timestamp,
        size: f64,
        rate_per_year: f64,
    }

    /// Days with a season, weather, AR(1) noise and a change of `size` from day `onset` (not whole) on.
    fn series(days: usize, onset: f64, size: f64, step: bool, phi: f64, seed: u64) -> (Vec<Sample>, Truth) {
        let begin = Timestamp::from_nanos(1_700_000_000_000_000_000);
        let mut generator = random::stream(seed, 1);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut generator) };
        let (mut weather, mut error) = (normal(), normal());
        let span = days as f64 - 0.5 - onset;
        let samples = (0..days)
            .map(|day| {
                let t = day as f64;
                weather = 0.7 * weather + 0.7 * normal();
                error = phi * error + (1.0 - phi * phi).sqrt() * normal();
                let warmer_k = 7.0 * (t / 58.0).sin() + 2.0 * weather;
                // A period holds the middle of its day.
                let after = t + 0.5 - onset;
                let change = match (after > 0.0, step) {
                    (false, _) => 0.0,
                    (true, true) => size,
                    (true, false) => size * after / span,
                };
                let delta = libm::log(1.0 + BETA * warmer_k + change) + NOISE * error;
                Sample {
                    start: begin.plus_seconds(t * DAY_S),
                    delta,
                    warmer_k,
                }
            })
            .collect();
        let truth = Truth {
            onset: begin.plus_seconds(onset * DAY_S),
            size,
            rate_per_year: size / span * 365.25,
        };
        (samples, truth)
    }

    fn covers(interval: &Interval, truth: f64) -> bool {
        (interval.q025..=interval.q975).contains(&truth)
    }

    /// Shares of 95 % intervals that hold onset, size and rate, and the mean probability given to a step.
    fn coverage(runs: u64, step: bool, phi: f64, size: impl Fn(f64) -> f64) -> [f64; 4] {
        let mut held = [0.0; 4];
        for run in 0..runs {
            let mut generator = random::stream(run, 77);
            let draw: f64 = StandardNormal.sample(&mut generator);
            let place: f64 = rand::RngExt::random(&mut generator);
            let (samples, truth) = series(120, 1.0 + 118.0 * place, size(draw), step, phi, run);
            let change = estimate(&samples, 0, phi).unwrap();
            held[0] += f64::from((change.onset_q025..=change.onset_q975).contains(&truth.onset));
            held[1] += f64::from(covers(&change.size, truth.size));
            held[2] += f64::from(covers(&change.rate_per_year, truth.rate_per_year));
            held[3] += change.step_probability;
        }
        held.map(|sum| sum / runs as f64)
    }

    #[test]
    fn intervals_hold_what_they_promise() {
        // Onset uniform, size from its prior, both shapes alike: the setting in which 95 % is exact but for the noise
        // that is taken from the best onset. 1500 runs have a binomial sd of 0.6 %.
        let phi = 0.3;
        let steps = coverage(750, true, phi, |draw| SIZE_SD * draw);
        let ramps = coverage(750, false, phi, |draw| SIZE_SD * draw);
        for (what, (a, b)) in ["onset", "size"].iter().zip(steps.iter().zip(&ramps)) {
            let share = 0.5 * (a + b);
            assert!((0.93..=0.97).contains(&share), "{what}: {a} {b}");
        }
        assert!((0.93..=0.975).contains(&ramps[2]), "rate {}", ramps[2]);
        assert!(steps[3] > 0.85 && ramps[3] < 0.15, "{} {}", steps[3], ramps[3]);
    }

    #[test]
    #[ignore = "campaign: coverage at given sizes, a minute; run with --nocapture"]
    fn campaign() {
        for size in [-0.2, -0.05, -0.02, -0.01] {
            for step in [true, false] {
                for phi in [0.0, 0.4] {
                    let [onset, held, rate, probability] = coverage(2000, step, phi, |_| size);
                    println!(
                        "size {size:+.2} step {step:5} phi {phi:.1}: onset {onset:.3} size {held:.3} rate {rate:.3} P(step) {probability:.2}"
                    );
                }
            }
        }
    }

    #[test]
    fn suffix_sums_agree_with_plain_least_squares() {
        // One onset and shape at a time by Gram and Schmidt on whole columns, which shares nothing with the sums.
        let phi = 0.3;
        let (samples, _) = series(60, 40.2, -0.03, true, phi, 3);
        let columns = columns(&samples, phi, DAY_S);
        let share = |index: usize| index as f64 / 59.0;
        let parts = posterior(&columns, 0, share).unwrap();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let level: Vec<f64> = samples.iter().map(|s| s.delta.exp()).collect();
        let whitened = |values: Vec<f64>| -> Vec<f64> {
            let scaled: Vec<f64> = values.iter().zip(&level).map(|(v, q)| v / q).collect();
            (0..scaled.len())
                .map(|i| match i {
                    0 => scaled[0],
                    i => (scaled[i] - phi * scaled[i - 1]) / (1.0 - phi * phi).sqrt(),
                })
                .collect()
        };
        for part in parts.iter().filter(|part| part.weight > 1e-4) {
            let begin = 1.0 - part.length;
            let shape = (0..60).map(|i| match (i >= part.cell, part.step) {
                (false, _) => 0.0,
                (true, true) => 1.0,
                (true, false) => (share(i) - begin) / (1.0 - begin),
            });
            let mut basis = [
                whitened(vec![1.0; 60]),
                whitened(samples.iter().map(|s| s.warmer_k).collect()),
                whitened(shape.collect()),
            ];
            let response = whitened(samples.iter().map(|s| s.delta.exp_m1()).collect());
            for i in 1..3 {
                for j in 0..i {
                    let along = dot(&basis[i], &basis[j]) / dot(&basis[j], &basis[j]);
                    let other = basis[j].clone();
                    basis[i].iter_mut().zip(other).for_each(|(v, w)| *v -= along * w);
                }
            }
            let size = dot(&basis[2], &response) / dot(&basis[2], &basis[2]);
            // The size's prior shrinks by (noise / 0.1)^2 over the shape's norm.
            assert!((part.size - size).abs() < 2e-3 * size.abs(), "{part:?} {size}");
        }
    }

    #[test]
    fn a_clear_step_and_a_clear_ramp() {
        let (samples, truth) = series(200, 150.0, -0.05, true, 0.2, 8);
        let change = estimate(&samples, 0, 0.2).unwrap();
        assert!(change.step_probability > 0.99);
        assert!(change.onset.seconds_since(truth.onset).abs() < DAY_S);
        assert!((change.size.mean + 0.05).abs() < 0.002, "{:?}", change.size);
        let (samples, truth) = series(400, 200.0, -0.04, false, 0.0, 9);
        let change = estimate(&samples, 0, 0.0).unwrap();
        assert!(change.step_probability < 0.01);
        assert!(change.onset.seconds_since(truth.onset).abs() < 30.0 * DAY_S);
        assert!(
            (change.rate_per_year.mean - truth.rate_per_year).abs() < 0.01,
            "{change:?}"
        );
    }

    #[test]
    fn odd_series_neither_panic_nor_lie() {
        let (samples, _) = series(60, 30.0, -0.05, true, 0.0, 1);
        assert_eq!(estimate(&samples[..7], 0, 0.0), None);
        assert_eq!(estimate(&[], 0, 0.0), None);
        let mut twice = samples.clone();
        twice[4].start = twice[3].start;
        assert_eq!(estimate(&twice, 0, 0.0), None);
        let mut broken = samples.clone();
        broken[4].delta = f64::NAN;
        assert_eq!(estimate(&broken, 0, 0.0), None);
        // Constant series, no temperature, extreme values.
        for (delta, warmer_k) in [(0.0, 0.0), (0.01, 5.0), (500.0, 1e9), (-500.0, -1e9)] {
            let flat: Vec<Sample> = samples
                .iter()
                .map(|s| Sample {
                    delta,
                    warmer_k,
                    ..*s
                })
                .collect();
            if let Some(change) = estimate(&flat, 0, 0.5) {
                let size = change.size;
                assert!(
                    [size.mean, size.sd, size.q025, size.q975]
                        .iter()
                        .all(|v| v.is_finite()),
                    "{change:?}"
                );
                assert!(change.onset_q025 <= change.onset && change.onset <= change.onset_q975);
            }
        }
        // Weeks of silence.
        let gappy: Vec<Sample> = samples[..20].iter().chain(&samples[45..]).copied().collect();
        assert!(estimate(&gappy, 0, 0.4).is_some_and(|change| (change.size.mean + 0.05).abs() < 0.01));
    }
}
