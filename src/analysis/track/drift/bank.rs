//! One bank of Kalman filters with unknown noise: the conjugate law of coefficients, fluctuation and noise variance for every
//! member, and the mixture of their predictive laws.
//!
//! For a period with ratio y, stated error s (typically s1) and columns X, and an onset's regressor h (0 without one, 1 for a step, years
//! since the onset for a ramp), a member holds the state x = (c, a, b_1.., v, u):
//!
//! ```text
//! y = c h + a + X b + v + u + sqrt(sigma^2 R + q) e,    R = 0.3 + 0.7 (s / s1)^2,     e ~ N(0, 1)
//! u <- f u + sigma sqrt(r (1 - f^2)) n,              f = exp(-gap / tau);           v likewise with r2, tau2
//! sigma^2 ~ inverse gamma(alpha, beta),              cov(x) = sigma^2 P
//! q = E[b'U b]
//! ```
//!
//! with U the covariance of the filters' errors by what the temperature did since its last reading (`unread.rs`; zero where they are dense):
//! y has Student's t law with 2 alpha degrees of freedom, S = R + q / sigma^2 + H P H' and scale^2 = S beta / alpha. Three more terms
//! keep wild readings, sudden weather and spells of larger noise from being learned as something else, with the probability w of such a
//! spell (`spells.rs`):
//!
//! ```text
//! p(y) = 0.01 t_3(e; 0.06^2 + 9 S) + (1 - w) ((0.99 - k) t(e; S) + k t(e; S + 24 r (1 - f^2))) + 0.99 w t_3(e; S + 13 R)
//! ```
//!

use super::block::{Block, LANES, Lanes, Step, Sums, Workspace};
use super::densities::{KICK, WILD, WILD_SD, WILD_SHAPE, WILD_WIDER, rougher};
use super::member::{Member, Placed};
use super::passage::Passage;
use super::prior::BankPrior;
use super::row::{COLUMNS, Law, Row};
use super::spells::FREEDOM;
use super::unread::Covariance;
use crate::numerics::simd::{Kernel, vectorised};
use rand::{Rng, RngExt};
use rand_distr::{ChiSquared, Distribution, StandardNormal};
use serde::{Deserialize, Serialize, Serializer};

/// Least weight in a bank that must keep every member: one may become likely again.
const LEAST_WEIGHT: f64 = 1e-26;
/// Least weight that an onset particle keeps. What is left is a density of its own, so that R stays as rare.
const NEGLIGIBLE_WEIGHT: f64 = 0.005;

/// Filters side by side, one per member.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(from = "Kept<Member>")]
pub(super) struct Bank {
    /// Time of the last period.
    pub day: Option<f64>,
    /// Number of members.
    count: usize,
    blocks: Vec<Block>,
}

/// A bank as it is kept, member by member.
#[derive(Serialize, Deserialize)]
struct Kept<M> {
    day: Option<f64>,
    members: Vec<M>,
}

impl From<Kept<Member>> for Bank {
    fn from(kept: Kept<Member>) -> Self {
        Self {
            day: kept.day,
            count: kept.members.len(),
            blocks: kept.members.chunks(LANES).map(Block::new).collect(),
        }
    }
}

impl Serialize for Bank {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let members = self.places().map(|(block, lane)| Placed::new(block, lane));
        let kept = Kept {
            day: self.day,
            members: members.collect(),
        };
        kept.serialize(serializer)
    }
}

impl Bank {
    /// A bank before the first period.
    pub fn new(prior: &BankPrior) -> Self {
        let members = (0..prior.members.len().min(256)).map(|which| Member::new(prior, which));
        let mut bank = Self::from(Kept {
            day: None,
            members: members.collect(),
        });
        bank.normalise();
        bank
    }

    /// Blocks and lanes of the members.
    fn places(&self) -> impl Iterator<Item = (&Block, usize)> {
        let lanes = |block| (0..LANES).map(move |lane| (block, lane));
        self.blocks.iter().flat_map(lanes).take(self.count)
    }

    /// Weights of the members.
    fn weights(&mut self) -> impl Iterator<Item = &mut f64> {
        let blocks = self.blocks.iter_mut();
        blocks.flat_map(|block| &mut block.weight).take(self.count)
    }

    /// A copy without negligible members.
    fn without_negligible(&self) -> Self {
        let counts = |(block, lane): &(&Block, usize)| block.weight[*lane] >= NEGLIGIBLE_WEIGHT;
        let kept: Vec<_> = self.places().filter(counts).collect();
        let mut bank = Self {
            day: self.day,
            count: kept.len(),
            blocks: kept.chunks(LANES).map(Block::of).collect(),
        };
        bank.normalise();
        bank
    }

    /// A copy in which the change has standard deviation `size`, without negligible members.
    pub fn with_change(&self, size: f64) -> Self {
        let mut bank = self.without_negligible();
        bank.blocks
            .iter_mut()
            .for_each(|block| block.widen(0, size * size));
        bank
    }

    /// A copy in which the change is what it came to by now, `so_far` times c, and as much more as has standard deviation `size`.
    pub fn changed_again(&self, so_far: f64, size: f64) -> Self {
        let mut bank = self.without_negligible();
        for block in &mut bank.blocks {
            block.scale_change(so_far);
            block.widen(0, size * size);
        }
        bank
    }

    /// Makes weights sum to one.
    fn normalise(&mut self) {
        let total: f64 = self.weights().map(|weight| *weight).sum();
        self.weights().for_each(|weight| *weight /= total);
    }

    /// Forgets members whose weight is negligible.
    pub fn prune(&mut self) {
        if self.weights().any(|weight| *weight < NEGLIGIBLE_WEIGHT) {
            *self = self.without_negligible();
        } else {
            self.normalise();
        }
    }

    /// Advances time.
    pub fn advance(&mut self, passage: &Passage) {
        vectorised(Advance {
            blocks: &mut self.blocks,
            passage,
        });
        self.day = Some(passage.day);
    }

    /// Learns a row after the passage to it; returns ln p(y).
    pub fn learn(
        &mut self,
        prior: &BankPrior,
        row: &Row,
        passage: &Passage,
        workspace: &mut Workspace,
    ) -> f64 {
        let step = Step {
            row,
            passage,
            kick: prior.kick,
        };
        vectorised(Learn {
            blocks: &mut self.blocks,
            step,
            workspace,
        });
        let density: f64 = self.weights().map(|weight| *weight).sum();
        self.weights()
            .for_each(|weight| *weight = (*weight / density).max(LEAST_WEIGHT));
        libm::log(density)
    }

    /// Narrows the covariances as any ratio of a row would; means, noise and weights stay.
    pub fn narrow(&mut self, row: &Row) {
        let mut along = vec![[0.0; LANES]; row.x.len()];
        for block in &mut self.blocks {
            block.narrow(row, &mut along);
        }
    }

    /// A ratio drawn from the predictive law after the passage to a row.
    pub fn draw<R: Rng>(
        &self,
        prior: &BankPrior,
        row: &Row,
        passage: &Passage,
        generator: &mut R,
    ) -> Option<f64> {
        let mut left: f64 = generator.random();
        let mut chosen = None;
        for (block, lane) in self.places() {
            chosen = Some((block, lane));
            left -= block.weight[lane];
            if left < 0.0 {
                break;
            }
        }
        let (block, lane) = chosen?;
        let ahead = block.ahead(row, &mut vec![[0.0; LANES]; row.x.len()]);
        let (error, total) = (ahead.error[lane], ahead.total[lane]);
        let (scale2, shape) = (block.scale2()[lane], block.shape[lane]);
        let term: f64 = generator.random();
        let rough = block.spells.rough()[lane];
        let calm_from = WILD + (1.0 - WILD) * rough;
        let (scale2, shape) = if term < WILD {
            (WILD_SD * WILD_SD + WILD_WIDER * total * scale2, WILD_SHAPE)
        } else if term < calm_from {
            (rougher(total, row.error) * scale2, 0.5 * FREEDOM)
        } else if term < calm_from + (1.0 - rough) * prior.kick {
            let kicked = KICK * passage.of(block.which[lane]).added;
            ((total + kicked) * scale2, shape)
        } else {
            (total * scale2, shape)
        };
        let normal: f64 = StandardNormal.sample(generator);
        let divisor = ChiSquared::new(2.0 * shape).map_or(1.0, |law| law.sample(generator) / (2.0 * shape));
        Some(row.ratio - error + normal * (scale2 / divisor).sqrt())
    }

    /// Predictive law, calm or rough, at the time the bank was advanced to; wild readings and jumps are left out.
    pub fn law(&self, row: &Row) -> Law {
        let (mut sums, mut of_coefficients) = (Sums::default(), [0.0; LANES]);
        vectorised(Predict {
            blocks: &self.blocks,
            row,
            sums: &mut sums,
            of_coefficients: &mut of_coefficients,
        });
        let [mean, square, variance] = [sums.mean, sums.square, sums.variance].map(total);
        let between = (square - mean * mean).max(0.0);
        let variance = variance + between;
        Law {
            mean,
            sd: variance.sqrt(),
            leverage: ((total(of_coefficients) + between) / variance).clamp(0.0, 1.0),
        }
    }

    /// Adds the law of x'b + e over the columns to sums over a mixture in which the bank has a share: var e = sigma^2 `own`, by the index
    /// of a member, `white` as the last period was calm or rough, and `unread`.
    pub fn add_columns(
        &self,
        x: &[f64],
        own: &[f64],
        [white, unread]: [f64; 2],
        share: f64,
        sums: &mut Sums,
    ) {
        vectorised(Columns {
            blocks: &self.blocks,
            x,
            own,
            white,
            unread,
            share,
            sums,
        });
    }

    /// Resets the uncertainty of the level to that before the first period.
    pub fn loosen(&mut self, prior: &BankPrior) {
        let variance = prior.intercept_sd * prior.intercept_sd;
        self.blocks.iter_mut().for_each(|block| block.widen(1, variance));
    }

    /// Variance of a ratio whose filters have errors of covariance U \[K^2\]: E[b'U b] over the slopes b.
    pub fn unread(&self, unread_k2: &Covariance) -> f64 {
        let mut sum = [0.0; LANES];
        for block in &self.blocks {
            let (mean, noise) = (block.mean(), block.noise());
            for (i, row) in unread_k2.iter().enumerate() {
                for (j, unread_k2) in row.iter().enumerate() {
                    let (one, other) = (COLUMNS + i.min(j), COLUMNS + i.max(j));
                    let cov = block.cov(one, other);
                    for l in 0..LANES {
                        let slopes = mean[one][l] * mean[other][l] + noise[l] * cov[l];
                        sum[l] += block.weight[l] * unread_k2 * slopes;
                    }
                }
            }
        }
        total(sum).max(0.0)
    }

    /// Mean and standard deviation of the change c.
    pub fn change(&self) -> (f64, f64) {
        let (mut mean, mut square, mut variance) = (0.0, 0.0, 0.0);
        for (block, l) in self.places() {
            let (weight, change) = (block.weight[l], block.mean()[0][l]);
            mean += weight * change;
            square += weight * change * change;
            variance += weight * block.noise()[l] * block.cov(0, 0)[l];
        }
        (mean, (variance + (square - mean * mean).max(0.0)).sqrt())
    }
}

/// Sum over lanes.
pub(super) fn total(lanes: Lanes) -> f64 {
    lanes.iter().sum()
}

/// Lets the fluctuations of every block decay.
struct Advance<'a> {
    blocks: &'a mut [Block],
    passage: &'a Passage,
}

impl Kernel for Advance<'_> {
    #[inline(always)]
    fn run(self) {
        for block in self.blocks {
            block.advance(self.passage);
        }
    }
}

/// Lets every block learn a row.
struct Learn<'a> {
    blocks: &'a mut [Block],
    step: Step<'a>,
    workspace: &'a mut Workspace,
}

impl Kernel for Learn<'_> {
    #[inline(always)]
    fn run(self) {
        self.step.teach(self.blocks, self.workspace);
    }
}

/// Sums of a predictive law over every block.
struct Predict<'a> {
    blocks: &'a [Block],
    row: &'a Row,
    sums: &'a mut Sums,
    of_coefficients: &'a mut Lanes,
}

impl Kernel for Predict<'_> {
    #[inline(always)]
    fn run(self) {
        let mut along = vec![[0.0; LANES]; self.row.x.len()];
        for block in self.blocks {
            block.add_law(self.row, &mut along, self.sums, self.of_coefficients);
        }
    }
}

/// Sums of what the columns explain over every block.
struct Columns<'a> {
    blocks: &'a [Block],
    x: &'a [f64],
    own: &'a [f64],
    white: f64,
    unread: f64,
    share: f64,
    sums: &'a mut Sums,
}

impl Kernel for Columns<'_> {
    #[inline(always)]
    fn run(self) {
        for block in self.blocks {
            let scale2 = block.scale2();
            let noise = block.spells.noise();
            let own = std::array::from_fn(|l| {
                let white = self.white * noise[l];
                self.own[usize::from(block.which[l])] + white + self.unread / scale2[l]
            });
            block.add_columns(self.x, &own, self.share, self.sums);
        }
    }
}

#[cfg(test)]
mod tests;
