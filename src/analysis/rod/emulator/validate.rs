//! Errors of an emulator, in value and slope, on an independent sample from the prior.

use crate::numerics::random;
use crate::rod::beam::OutsideRange;
use crate::rod::beam::forward::{ForwardModel, MAX_MODES};
use crate::rod::prior::RodPrior;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Size of the absolute values of an error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Root of the mean square.
    pub rms: f64,
    /// The 99.9 % quantile.
    pub q999: f64,
    /// The largest value.
    pub max: f64,
}

impl Spread {
    /// Spread of `errors`; zeros if there are none.
    pub fn of(errors: &[f64]) -> Self {
        let mut sizes: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let count = sizes.len().max(1);
        let rank = (count as f64 * 0.999).ceil() as usize;
        let at = |rank: usize| sizes.get(rank.saturating_sub(1)).copied().unwrap_or(0.0);
        Self {
            rms: (sizes.iter().map(|e| e * e).sum::<f64>() / count as f64).sqrt(),
            q999: at(rank),
            max: at(count),
        }
    }
}

/// The errors of one mode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModeErrors {
    /// Mode order, from 1.
    pub order: usize,
    /// Error of the frequency \[Hz\].
    pub value_hz: Spread,
    /// Relative error of the frequency \[-\].
    pub relative: Spread,
    /// Error of the slope `d ln f / d ln N` \[-\]; `None` if the force is fixed, since the emulator then has
    /// no slope.
    pub slope: Option<Spread>,
}

/// The errors of one mode on the points it was fitted on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GridErrors {
    /// Mode order, from 1.
    pub order: usize,
    /// Mean of emulator minus model \[Hz\].
    pub mean_hz: f64,
    /// Variance of emulator minus model \[Hz^2\].
    pub variance_hz2: f64,
}

/// An emulator's error report.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ErrorReport {
    /// Name of the emulator.
    pub emulator: String,
    /// Name of the model taken as the truth on the sample.
    pub reference: String,
    /// Number of draws from the prior.
    pub sample: usize,
    /// Seed of the draws.
    pub seed: u64,
    /// Number of draws outside the emulator's range, which the exact model answers.
    pub outside: usize,
    /// Errors of the draws inside the range.
    pub modes: Vec<ModeErrors>,
    /// Errors of all draws had the emulator been extrapolated; `None` if none lies outside.
    pub extrapolated: Option<Vec<ModeErrors>>,
    /// Errors on the fitting points, for an emulator that keeps them.
    pub grid: Option<Vec<GridErrors>>,
}

/// Number of draws of the default report.
pub const SAMPLE: usize = 20_000;
/// Seed of the default report.
pub const SEED: u64 = 20_260_101;

/// Frequencies and slopes of one parameter vector, as a validation needs them of a model.
pub type Both<'a> = &'a (dyn Fn(&[f64], &mut [f64], &mut [f64]) -> Result<(), OutsideRange> + Sync);

/// Frequencies and slopes of a forward model; slopes it does not have are NaN.
pub fn both(model: &dyn ForwardModel) -> impl Fn(&[f64], &mut [f64], &mut [f64]) -> Result<(), OutsideRange> {
    move |theta, values, slopes| {
        model.frequencies(theta, values)?;
        if model.log_slopes(theta, slopes).is_err() {
            slopes.fill(f64::NAN);
        }
        Ok(())
    }
}

/// Compares `emulator` with `reference` on `sample` draws from `prior`, in parallel blocks with a stream each.
///
/// `extrapolate` answers outside the emulator's range, for the report only. Draws the reference refuses are
/// left out. `judged` is called with the number of draws newly done.
pub fn on_prior(
    emulator: &dyn ForwardModel,
    extrapolate: Option<Both>,
    reference: &dyn ForwardModel,
    prior: &RodPrior,
    (sample, seed): (usize, u64),
    judged: &(dyn Fn(usize) + Sync),
) -> ErrorReport {
    let modes = emulator.modes().min(reference.modes()).min(MAX_MODES);
    let blocks: Vec<Block> = (0..sample.div_ceil(random::BLOCK))
        .into_par_iter()
        .map(|block| {
            let mut generator = random::stream(seed, block as u64);
            let mut theta = vec![0.0; prior.parameterisation().len()];
            let mut errors = Block::new(modes);
            let count = random::BLOCK.min(sample - block * random::BLOCK);
            for _ in 0..count {
                prior.sample(&mut generator, &mut theta);
                errors.judge(&theta, &both(emulator), extrapolate, &both(reference));
            }
            judged(count);
            errors
        })
        .collect();
    let mut all = Block::new(modes);
    blocks.into_iter().for_each(|block| all.append(block));
    ErrorReport {
        emulator: emulator.name().to_owned(),
        reference: reference.name().to_owned(),
        sample,
        seed,
        outside: all.outside,
        modes: all.inside.report(),
        extrapolated: (all.outside > 0 && extrapolate.is_some()).then(|| all.anywhere.report()),
        grid: None,
    }
}

/// Errors of one block of draws.
struct Block {
    inside: Errors,
    anywhere: Errors,
    outside: usize,
    modes: usize,
}

impl Block {
    fn new(modes: usize) -> Self {
        Self {
            inside: Errors::new(modes),
            anywhere: Errors::new(modes),
            outside: 0,
            modes,
        }
    }

    fn judge(&mut self, theta: &[f64], emulator: Both, extrapolate: Option<Both>, reference: Both) {
        let ask = |model: Both| {
            let mut answer = [[0.0; MAX_MODES]; 2];
            let [values, slopes] = &mut answer;
            model(theta, &mut values[..self.modes], &mut slopes[..self.modes]).map(|()| answer)
        };
        let Ok(truth) = ask(reference) else { return };
        match (ask(emulator), extrapolate) {
            (Ok(answer), _) => {
                self.inside.add(&answer, &truth);
                self.anywhere.add(&answer, &truth);
            }
            (Err(_), extrapolate) => {
                if let Some(Ok(answer)) = extrapolate.map(ask) {
                    self.anywhere.add(&answer, &truth);
                }
                self.outside += 1;
            }
        }
    }

    fn append(&mut self, other: Self) {
        self.inside.append(other.inside);
        self.anywhere.append(other.anywhere);
        self.outside += other.outside;
    }
}

/// The errors of every mode, collected.
struct Errors {
    value: Vec<Vec<f64>>,
    relative: Vec<Vec<f64>>,
    slope: Vec<Vec<f64>>,
}

impl Errors {
    fn new(modes: usize) -> Self {
        let empty = || vec![Vec::new(); modes];
        Self {
            value: empty(),
            relative: empty(),
            slope: empty(),
        }
    }

    fn add(&mut self, answer: &[[f64; MAX_MODES]; 2], truth: &[[f64; MAX_MODES]; 2]) {
        for mode in 0..self.value.len() {
            let error = answer[0][mode] - truth[0][mode];
            self.value[mode].push(error);
            self.relative[mode].push(error / truth[0][mode]);
            let error = answer[1][mode] - truth[1][mode];
            self.slope[mode].extend(error.is_finite().then_some(error));
        }
    }

    fn append(&mut self, other: Self) {
        let join = |to: &mut Vec<Vec<f64>>, from: Vec<Vec<f64>>| {
            to.iter_mut().zip(from).for_each(|(to, from)| to.extend(from));
        };
        join(&mut self.value, other.value);
        join(&mut self.relative, other.relative);
        join(&mut self.slope, other.slope);
    }

    fn report(&self) -> Vec<ModeErrors> {
        (0..self.value.len())
            .map(|mode| ModeErrors {
                order: mode + 1,
                value_hz: Spread::of(&self.value[mode]),
                relative: Spread::of(&self.relative[mode]),
                slope: (!self.slope[mode].is_empty()).then(|| Spread::of(&self.slope[mode])),
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::beam::Exact;

    #[test]
    fn the_spread_is_of_sizes() {
        let errors: Vec<f64> = (1..=2000)
            .map(|i| if i % 2 == 0 { i as f64 } else { -(i as f64) })
            .collect();
        let spread = Spread::of(&errors);
        assert_eq!((spread.q999, spread.max), (1998.0, 2000.0));
        // Mean of squares: (n + 1)(2n + 1) / 6.
        assert!((spread.rms - (2001.0f64 * 4001.0 / 6.0).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn a_model_agrees_with_itself() {
        let prior = RodPrior::todi();
        let exact = Exact::new(*prior.parameterisation());
        let report = on_prior(&exact, None, &exact, &prior, (100, 1), &|_| ());
        assert_eq!((report.sample, report.outside), (100, 0));
        assert!(
            report
                .modes
                .iter()
                .all(|mode| mode.value_hz.max == 0.0 && mode.slope.is_some_and(|s| s.max == 0.0))
        );
    }
}
