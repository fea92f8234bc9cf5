//! The parts of a record between its onsets, each with the state at its beginning.

use super::likelihood::Start;
use super::onsets::{Release, releases, train};
use crate::signal::record::{Excitation, Record};

/// Shortest part that is fitted, in periods of the strongest peak: its band then holds two dozen lines.
const LEAST_PERIODS: f64 = 36.0;
/// Shortest decay that is fitted where no part is longer, in periods of the strongest peak.
const LEAST_DECAY_PERIODS: f64 = 15.0;
/// The same between the blows of a train, where a fit of the whole record would be one of a comb.
const LEAST_TRAIN_PERIODS: f64 = 5.0;
/// Periods within which a release and a blow of a train are one.
const SAME_PERIODS: f64 = 2.0;
/// Fewest samples of a part that a spectrum is made of.
const LEAST_SAMPLES: usize = 64;
/// Least ratio of the mean square motion in the first quarter of a decay to that in the last.
const FALLS: f64 = 4.0;

/// Assumption on how a part of a record begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Beginning {
    /// Start known beforehand.
    Known(Start),
    /// Start tested on the part itself, mode by mode.
    Tested,
}

/// A part of a record, in samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part {
    /// Its first sample.
    pub from: usize,
    /// The first sample after it.
    pub to: usize,
    /// Assumption on its beginning.
    pub beginning: Beginning,
}

/// Division of a record into parts.
#[derive(Debug, Clone, PartialEq)]
pub struct Parts {
    /// Motions that begin within the record, in time order.
    pub releases: Vec<Release>,
    /// Part that moves most, where the peaks are fitted first.
    pub main: Part,
    /// Length of the record, and the shortest part worth a fit, in samples.
    total: usize,
    least: usize,
}

impl Parts {
    /// Divides a record. One with declared excitation is one part: all of it, or from its largest deflection
    /// on. Any other is divided at its releases, if it `has_releases`, and at the blows of a train. `scale_hz` is the frequency of its
    /// strongest peak.
    pub fn of(record: &Record, scale_hz: Option<f64>, has_releases: bool) -> Self {
        let samples = &record.samples;
        let total = samples.len();
        let known = |from, start| Part {
            from,
            to: total,
            beginning: Beginning::Known(start),
        };
        let whole = Part {
            from: 0,
            to: total,
            beginning: Beginning::Tested,
        };
        let mut parts = Self {
            releases: Vec::new(),
            main: whole,
            total,
            least: scale_hz.map_or(total, |f| (LEAST_PERIODS * record.fs_hz / f).ceil() as usize),
        };
        match (record.excitation, scale_hz) {
            (Some(Excitation::Ambient), _) => parts.main = known(0, Start::Stationary),
            (Some(Excitation::FreeDecay), _) => {
                parts.main = known(largest_deflection(samples), Start::Free);
            }
            (None, Some(scale_hz)) => {
                if has_releases {
                    parts.releases = releases(samples, record.fs_hz, scale_hz);
                }
                let period = record.fs_hz / scale_hz;
                let blows = train(samples, period);
                let least = match blows.is_empty() {
                    true => LEAST_DECAY_PERIODS,
                    false => LEAST_TRAIN_PERIODS,
                };
                parts.add_train(blows, period);
                let most = parts.between([]).into_iter().max_by(|a, b| {
                    let motion = |part: &Part| motion(&samples[part.from..part.to]);
                    motion(a).total_cmp(&motion(b))
                });
                parts.main = most
                    .or_else(|| parts.short_decay(samples, least * period))
                    .unwrap_or(whole);
                if parts.main == whole {
                    // What is told of the motion is what was fitted.
                    parts.releases.clear();
                }
            }
            (None, None) => {}
        }
        parts
    }

    /// Adds the blows of a train, less the releases that they are.
    fn add_train(&mut self, blows: Vec<Release>, period: f64) {
        let is_near = |a: &Release, b: &Release| a.after.abs_diff(b.after) as f64 <= SAME_PERIODS * period;
        self.releases
            .retain(|release| !blows.iter().any(|blow| is_near(blow, release)));
        self.releases.extend(blows);
        self.releases.sort_unstable_by_key(|release| release.after);
    }

    /// Parts between the onsets and further blows that are long enough; a blow is the last sample before and the first sample
    /// after it. What begins with a release may be a gust that set in, and is tested.
    pub fn between(&self, blows: impl IntoIterator<Item = (usize, usize)>) -> Vec<Part> {
        let free = Beginning::Known(Start::Free);
        let releases = self.releases.iter().map(|at| {
            let beginning = if at.is_of_train { free } else { Beginning::Tested };
            (at.before, at.after, beginning)
        });
        let blows = blows.into_iter().map(|(before, after)| (before, after, free));
        let mut cuts: Vec<_> = releases.chain(blows).collect();
        cuts.sort_unstable_by_key(|(before, after, _)| (*before, *after));
        let (mut from, mut beginning) = (0, Beginning::Tested);
        let mut parts = Vec::new();
        for (before, after, next) in cuts.into_iter().chain([(self.total, self.total, free)]) {
            if before >= from + self.least {
                parts.push(Part {
                    from,
                    to: before,
                    beginning,
                });
            }
            (from, beginning) = (after.max(from), next);
        }
        parts
    }

    /// The motion after a release that moves most, where every part is shorter than [`LEAST_PERIODS`]: a fit across the release
    /// would fit neither the quiet nor the decay. `None` if none has `least` samples.
    fn short_decay(&self, samples: &[f64], least: f64) -> Option<Part> {
        let least = (least.ceil() as usize).max(LEAST_SAMPLES);
        let ends = self.releases.iter().skip(1).map(|next| next.before);
        let decays = self.releases.iter().zip(ends.chain([self.total]));
        decays
            .filter(|(release, to)| *to >= release.after + least)
            .map(|(release, to)| Part {
                from: release.after,
                to,
                beginning: Beginning::Known(Start::Free),
            })
            .max_by(|a, b| {
                let motion = |part: &Part| motion(&samples[part.from..part.to]);
                motion(a).total_cmp(&motion(b))
            })
    }

    /// Shortest part worth a fit, in samples.
    pub fn least(&self) -> usize {
        self.least
    }

    /// True if the main part begins with a release, which may be a gust that set in.
    pub fn begins_at_release(&self) -> bool {
        self.main.beginning == Beginning::Tested && self.main.from > 0
    }

    /// Samples of the main part if it decays, so that quickly damped modes are searched for near its
    /// beginning.
    pub fn decay<'a>(&self, samples: &'a [f64]) -> Option<&'a [f64]> {
        let part = &samples[self.main.from..self.main.to];
        let quarter = part.len() / 4;
        let falls = || motion(&part[..quarter]) > FALLS * motion(&part[part.len() - quarter..]);
        let decays = match self.main.beginning {
            Beginning::Known(Start::Stationary) => false,
            Beginning::Known(Start::Free) => true,
            Beginning::Tested => self.begins_at_release() || falls(),
        };
        decays.then_some(part)
    }
}

/// Sum of the squared differences of neighbouring samples.
fn motion(samples: &[f64]) -> f64 {
    samples.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum()
}

/// Sample in the first half that deviates most from the mean of all.
fn largest_deflection(samples: &[f64]) -> usize {
    let mean = samples.iter().sum::<f64>() / samples.len().max(1) as f64;
    let (mut at, mut largest) = (0, 0.0);
    for (i, x) in samples[..samples.len() / 2].iter().enumerate() {
        if (x - mean).abs() > largest {
            (at, largest) = (i, (x - mean).abs());
        }
    }
    at
}
