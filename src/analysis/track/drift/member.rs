//! One member of a bank as it begins and as it is kept: a Kalman filter with unknown noise.

use super::block::{Block, Lanes};
use super::prior::BankPrior;
use super::spells::Spell;
use serde::{Deserialize, Serialize, Serializer};

/// Shape of the prior law of the noise variance: four degrees of freedom; its mean is 2 s0^2.
const SHAPE: f64 = 2.0;

/// State of one member.
#[derive(Deserialize)]
pub(super) struct Member {
    /// Index among the prior's members.
    pub which: u8,
    /// Its weight; those of a bank sum to one.
    pub weight: f64,
    /// alpha and beta of the noise variance's inverse gamma law.
    pub shape: f64,
    pub rate: f64,
    pub spell: Spell,
    /// Mean of the state: change, intercept, columns, slow fluctuation, fluctuation.
    pub mean: Vec<f64>,
    /// Covariance over the noise variance: upper triangle by rows.
    pub cov: Vec<f64>,
}

impl Member {
    /// A member before the first period.
    pub fn new(prior: &BankPrior, which: usize) -> Self {
        let fluctuation = &prior.members[which];
        let noise = prior.noise_sd * prior.noise_sd;
        let width = prior.columns.len() + 4;
        let mut mean = vec![0.0, 0.0];
        mean.extend(prior.columns.iter().map(|law| law.mean));
        mean.extend([0.0, 0.0]);
        let mut variances = vec![0.0, prior.intercept_sd * prior.intercept_sd / noise];
        variances.extend(prior.columns.iter().map(|law| law.sd * law.sd / noise));
        variances.extend([fluctuation.slow_variance, fluctuation.variance]);
        let mut cov = vec![0.0; entries(width)];
        for (row, variance) in variances.into_iter().enumerate() {
            cov[place(width, row, row)] = variance;
        }
        Self {
            which: which as u8,
            weight: fluctuation.probability,
            shape: SHAPE,
            rate: 2.0 * (SHAPE - 1.0) * noise,
            spell: Spell::new(prior.spells),
            mean,
            cov,
        }
    }
}

/// A [`Member`] in its block, to be kept.
#[derive(Serialize)]
pub(super) struct Placed<'a> {
    which: u8,
    weight: f64,
    shape: f64,
    rate: f64,
    spell: Spell,
    mean: Lane<'a>,
    cov: Lane<'a>,
}

impl<'a> Placed<'a> {
    /// The member in a lane of a block.
    pub fn new(block: &'a Block, lane: usize) -> Self {
        Self {
            which: block.which[lane],
            weight: block.weight[lane],
            shape: block.shape[lane],
            rate: block.rate[lane],
            spell: block.spells.of(lane),
            mean: Lane(block.mean(), lane),
            cov: Lane(block.covs(), lane),
        }
    }
}

/// One lane of a list.
struct Lane<'a>(&'a [Lanes], usize);

impl Serialize for Lane<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(|lanes| lanes[self.1]))
    }
}

/// Number of entries of the upper triangle.
pub(super) const fn entries(width: usize) -> usize {
    width * (width + 1) / 2
}

/// Index of an entry of the upper triangle.
pub(super) const fn place(width: usize, row: usize, column: usize) -> usize {
    row * width - row * (row + 1) / 2 + column
}
