//! A few members of a bank side by side: their predictions and their steps, on vectors of the processor.
//!
//! Where members are fewer than the lanes, the last one is repeated without weight.

use super::densities::{Gammas, KICK, Spreads, WILD, raise, rougher};
use super::member::{Member, place};
use super::passage::{Decay, Passage};
use super::row::{COLUMNS, Row};
use super::spells::{FREEDOM, ROUGHER, Spells};

/// Members side by side.
pub(super) const LANES: usize = 4;
/// One number of each.
pub(super) type Lanes = [f64; LANES];

/// Members side by side; their state as [`Member`] has it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Block {
    pub which: [u8; LANES],
    pub weight: Lanes,
    pub shape: Lanes,
    pub rate: Lanes,
    pub spells: Spells,
    width: usize,
    /// Means, then covariances.
    state: Vec<Lanes>,
}

/// Memory that a step of a bank needs, block by block.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    /// P H'.
    along: Vec<Lanes>,
    ahead: Vec<Ahead>,
    /// As [`Spreads::offs`] and [`raise`] have them.
    powers: Vec<[Lanes; 2]>,
    gammas: Gammas,
}

/// Predictions of a row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ahead {
    pub error: Lanes,
    /// S = R + q alpha / beta + H P H'.
    pub total: Lanes,
}

/// Sums over the members of a mixture: weights, means, their squares, variances.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Sums {
    pub weight: Lanes,
    pub mean: Lanes,
    pub square: Lanes,
    pub variance: Lanes,
}

impl Block {
    /// The first members of a list, as many as there are lanes; the list is not empty.
    pub fn new(members: &[Member]) -> Self {
        let lanes: [usize; LANES] = std::array::from_fn(|l| l.min(members.len() - 1));
        let of = |number: fn(&Member) -> f64| lanes.map(|l| number(&members[l]));
        let width = members[0].mean.len();
        let mut state = vec![[0.0; LANES]; width + members[0].cov.len()];
        for (l, lane) in lanes.into_iter().enumerate() {
            let from = members[lane].mean.iter().chain(&members[lane].cov);
            state.iter_mut().zip(from).for_each(|(to, from)| to[l] = *from);
        }
        Self {
            which: lanes.map(|l| members[l].which),
            weight: std::array::from_fn(|l| members.get(l).map_or(0.0, |member| member.weight)),
            shape: of(|member| member.shape),
            rate: of(|member| member.rate),
            spells: Spells::new(lanes.map(|l| members[l].spell)),
            width,
            state,
        }
    }

    /// The first of some members of blocks, as many as there are lanes; there is one at least.
    pub fn of(members: &[(&Self, usize)]) -> Self {
        let lanes: [(&Self, usize); LANES] = std::array::from_fn(|l| members[l.min(members.len() - 1)]);
        let first = lanes[0].0;
        let mut state = vec![[0.0; LANES]; first.state.len()];
        for (l, (block, lane)) in lanes.into_iter().enumerate() {
            for (to, from) in state.iter_mut().zip(&block.state) {
                to[l] = from[lane];
            }
        }
        Self {
            which: lanes.map(|(block, lane)| block.which[lane]),
            weight: std::array::from_fn(|l| members.get(l).map_or(0.0, |(block, lane)| block.weight[*lane])),
            shape: lanes.map(|(block, lane)| block.shape[lane]),
            rate: lanes.map(|(block, lane)| block.rate[lane]),
            spells: Spells::new(lanes.map(|(block, lane)| block.spells.of(lane))),
            width: first.width,
            state,
        }
    }

    /// Mean of the state.
    pub fn mean(&self) -> &[Lanes] {
        &self.state[..self.width]
    }

    /// Covariance over the noise variance: upper triangle by rows.
    pub fn covs(&self) -> &[Lanes] {
        &self.state[self.width..]
    }

    /// An entry of the covariance, `row` not after `column`.
    pub fn cov(&self, row: usize, column: usize) -> &Lanes {
        &self.covs()[place(self.width, row, column)]
    }

    /// Adds to the variance of an entry of the state.
    pub fn widen(&mut self, entry: usize, variance: f64) {
        let scale2 = self.scale2();
        let lanes = &mut self.state[self.width + place(self.width, entry, entry)];
        for l in 0..LANES {
            lanes[l] += variance / scale2[l];
        }
    }

    /// Puts the change, the first entry of the state, into units of `unit`: c becomes `unit` times what it was.
    pub fn scale_change(&mut self, unit: f64) {
        let scaled = |lanes: &mut Lanes| lanes.iter_mut().for_each(|value| *value *= unit);
        scaled(&mut self.state[0]);
        for entry in 0..self.width {
            scaled(&mut self.state[self.width + place(self.width, 0, entry)]);
        }
        scaled(&mut self.state[self.width + place(self.width, 0, 0)]);
    }

    /// beta / alpha.
    #[inline(always)]
    pub fn scale2(&self) -> Lanes {
        std::array::from_fn(|l| self.rate[l] / self.shape[l])
    }

    /// Posterior mean of the noise variance.
    #[inline(always)]
    pub fn noise(&self) -> Lanes {
        std::array::from_fn(|l| self.rate[l] / (self.shape[l] - 1.0))
    }

    /// Lets the fluctuations decay, and spells of larger noise begin and end.
    #[inline(always)]
    pub fn advance(&mut self, passage: &Passage) {
        self.spells.advance(passage.spell_goes_on, &self.shape);
        let width = self.width;
        let (slow, fast) = (width - 2, width - 1);
        let decays = self.which.map(|which| passage.of(which));
        let of = |number: fn(&Decay) -> f64| decays.map(number);
        let (f, g) = (of(|decay| decay.fast), of(|decay| decay.slow));
        let (added, slow_added) = (of(|decay| decay.added), of(|decay| decay.slow_added));
        let (mean, mut rows) = self.state.split_at_mut(width);
        times_each(&mut mean[slow], &g);
        times_each(&mut mean[fast], &f);
        for row in 0..slow {
            let (entries, rest) = rows.split_at_mut(width - row);
            rows = rest;
            if let [.., of_slow, of_fast] = entries {
                times_each(of_slow, &g);
                times_each(of_fast, &f);
            }
        }
        if let [of_slow, both, of_fast] = rows {
            for l in 0..LANES {
                of_slow[l] = g[l] * g[l] * of_slow[l] + slow_added[l];
                both[l] *= f[l] * g[l];
                of_fast[l] = f[l] * f[l] * of_fast[l] + added[l];
            }
        }
    }

    /// Predictions of a row; `along` becomes P H'.
    #[inline(always)]
    pub fn ahead(&self, row: &Row, along: &mut [Lanes]) -> Ahead {
        let (mean, cov) = self.state.split_at(self.width);
        times(cov, &row.x, along);
        let (expected, beside, scale2) = (dot(&row.x, mean), dot(&row.x, along), self.scale2());
        Ahead {
            error: expected.map(|expected| row.ratio - expected),
            total: std::array::from_fn(|l| row.error + row.unread / scale2[l] + beside[l].max(0.0)),
        }
    }

    /// Variance that a jump adds to the fluctuations, in noise variances.
    #[inline(always)]
    fn kicked(&self, passage: &Passage) -> Lanes {
        self.which.map(|which| KICK * passage.of(which).added)
    }

    #[inline(always)]
    fn spreads(&self, total: &Lanes, step: &Step) -> Spreads {
        Spreads::new(
            total,
            step.row.error,
            &self.kicked(step.passage),
            &self.scale2(),
            &self.shape,
        )
    }

    /// Learns a row from its prediction, its P H' = `along` and its densities after the passage to it; weights become p(y, member).
    #[inline(always)]
    fn learn(&mut self, step: &Step, mut ahead: Ahead, along: &mut [Lanes], densities: &[Lanes; 4]) {
        let (mut is_kicked, mut learns, mut is_rough) = ([0.0; LANES], [1.0; LANES], [0.0; LANES]);
        let expected = self.spells.rough();
        for l in 0..LANES {
            let usual = (1.0 - WILD - step.kick) * densities[0][l];
            let wild = WILD * densities[1][l];
            let jump = step.kick * densities[2][l];
            let rough = (1.0 - WILD) * densities[3][l];
            self.spells.learn(l, [usual + jump + wild, rough + wild]);
            let calm = 1.0 - expected[l];
            let (usual, jump, rough) = (calm * usual, calm * jump, expected[l] * rough);
            self.weight[l] *= usual + wild + jump + rough;
            if jump > usual + rough && jump > wild {
                is_kicked[l] = 1.0;
            } else if wild > usual + rough {
                learns[l] = 0.0;
            } else {
                is_rough[l] = rough / (usual + rough);
            }
        }
        if is_kicked != [0.0; LANES] {
            let kicked = self.kicked(step.passage);
            if let Some(variance) = self.state.last_mut() {
                for l in 0..LANES {
                    variance[l] += is_kicked[l] * kicked[l];
                }
            }
            ahead = self.ahead(step.row, along);
        }
        // A lane whose reading is wild has no gain: it stays as it is.
        let (mut share, mut narrows) = ([0.0; LANES], [0.0; LANES]);
        let scale2 = self.scale2();
        for l in 0..LANES {
            let square = ahead.error[l] * ahead.error[l] / scale2[l];
            let usual = learns[l] / ahead.total[l];
            // Given that it is rough, its noise has the scale that Student's law expects of such an error.
            let own = step.row.error;
            let beyond = square / rougher(ahead.total[l], own);
            let noise = ROUGHER * own * (FREEDOM + beyond) / (FREEDOM + 1.0);
            let rough = learns[l] / (ahead.total[l] - own + noise);
            share[l] = usual + is_rough[l] * (rough - usual);
            // The means of both differ.
            let apart = is_rough[l] * (1.0 - is_rough[l]) * square * (usual - rough) * (usual - rough);
            narrows[l] = (share[l] - apart).max(0.0);
        }
        let gain: Lanes = std::array::from_fn(|l| ahead.error[l] * share[l]);
        for (mean, along) in self.state[..self.width].iter_mut().zip(along.iter()) {
            for l in 0..LANES {
                mean[l] += along[l] * gain[l];
            }
        }
        self.narrow_by(&narrows, along);
        for l in 0..LANES {
            self.rate[l] += 0.5 * ahead.error[l] * gain[l];
            self.shape[l] += 0.5 * learns[l];
        }
    }

    /// Narrows the covariances as any ratio of a row would; means, noise and weights stay.
    #[inline(always)]
    pub fn narrow(&mut self, row: &Row, along: &mut [Lanes]) {
        let share = self.ahead(row, along).total.map(f64::recip);
        self.narrow_by(&share, along);
    }

    /// Covariance after a row with P H' = `along` and 1 / S = `share`.
    #[inline(always)]
    fn narrow_by(&mut self, share: &Lanes, along: &[Lanes]) {
        let width = self.width;
        let mut rows = &mut self.state[width..];
        for row in 0..width {
            let (entries, rest) = rows.split_at_mut(width - row);
            rows = rest;
            let share: Lanes = std::array::from_fn(|l| along[row][l] * share[l]);
            for (entry, along) in entries.iter_mut().zip(&along[row..]) {
                for l in 0..LANES {
                    entry[l] -= share[l] * along[l];
                }
            }
            entries[0]
                .iter_mut()
                .for_each(|variance| *variance = variance.max(0.0));
        }
    }

    /// Adds the predictive law of a row to the sums over a mixture; to `of_coefficients` the part of the coefficients.
    #[inline(always)]
    pub fn add_law(&self, row: &Row, along: &mut [Lanes], sums: &mut Sums, of_coefficients: &mut Lanes) {
        let ahead = self.ahead(row, along);
        let noise = self.noise();
        let quadratic = self.quadratic(&row.x, 0..self.width - 2);
        let own = self.spells.noise();
        for l in 0..LANES {
            let location = row.ratio - ahead.error[l];
            let total = ahead.total[l] + (own[l] - 1.0) * row.error;
            sums.add(l, self.weight[l], location, noise[l] * total);
            of_coefficients[l] += self.weight[l] * noise[l] * quadratic[l];
        }
    }

    /// Adds the law of x'b + e over the columns, var e = sigma^2 `own`, to the sums over a mixture in which the bank has a share.
    #[inline(always)]
    pub fn add_columns(&self, x: &[f64], own: &Lanes, share: f64, sums: &mut Sums) {
        let columns = COLUMNS..self.width - 2;
        let explained = dot(&x[columns.clone()], &self.mean()[columns.clone()]);
        let (noise, quadratic) = (self.noise(), self.quadratic(x, columns));
        for l in 0..LANES {
            let variance = noise[l] * (own[l] + quadratic[l]);
            sums.add(l, share * self.weight[l], explained[l], variance);
        }
    }

    /// x'P x over some entries.
    #[inline(always)]
    fn quadratic(&self, x: &[f64], entries: std::ops::Range<usize>) -> Lanes {
        let mut sum = [0.0; LANES];
        for row in entries.clone() {
            let first = self.width + place(self.width, row, row);
            let own = &self.state[first];
            let beside = dot(
                &x[row + 1..entries.end],
                &self.state[first + 1..first + entries.end - row],
            );
            for l in 0..LANES {
                sum[l] += x[row] * (x[row] * own[l] + 2.0 * beside[l]);
            }
        }
        sum.map(|sum| sum.max(0.0))
    }
}

/// A row that a bank learns after the passage to it, and the probability of a jump.
pub(super) struct Step<'a> {
    pub row: &'a Row,
    pub passage: &'a Passage,
    pub kick: f64,
}

impl Step<'_> {
    /// Teaches the row to every block of a bank.
    #[inline(always)]
    pub fn teach(&self, blocks: &mut [Block], workspace: &mut Workspace) {
        let width = self.row.x.len();
        let Workspace {
            along,
            ahead,
            powers,
            gammas,
        } = workspace;
        along.resize(blocks.len() * width, [0.0; LANES]);
        ahead.clear();
        powers.clear();
        for (block, along) in blocks.iter().zip(along.chunks_exact_mut(width)) {
            let found = block.ahead(self.row, along);
            powers.push(block.spreads(&found.total, self).offs(&found.error));
            ahead.push(found);
        }
        raise(powers, blocks.iter().map(|block| block.shape));
        let found = ahead.iter().zip(powers.iter()).zip(along.chunks_exact_mut(width));
        for (block, ((ahead, powers), along)) in blocks.iter_mut().zip(found) {
            let gammas = block.shape.map(|shape| gammas.ratio(shape));
            let spreads = block.spreads(&ahead.total, self);
            let densities = spreads.densities(&ahead.error, powers, &gammas);
            block.learn(self, *ahead, along, &densities);
        }
    }
}

impl Sums {
    #[inline(always)]
    fn add(&mut self, lane: usize, weight: f64, mean: f64, variance: f64) {
        self.weight[lane] += weight;
        self.mean[lane] += weight * mean;
        self.square[lane] += weight * mean * mean;
        self.variance[lane] += weight * variance;
    }
}

#[inline(always)]
fn times_each(lanes: &mut Lanes, factor: &Lanes) {
    for l in 0..LANES {
        lanes[l] *= factor[l];
    }
}

/// Product of symmetric matrices and a vector.
#[inline(always)]
fn times(cov: &[Lanes], x: &[f64], product: &mut [Lanes]) {
    product.fill([0.0; LANES]);
    let mut left = cov;
    for row in 0..x.len() {
        let (entries, rest) = left.split_at(x.len() - row);
        left = rest;
        let head = x[row];
        let mut sum = [0.0; LANES];
        for l in 0..LANES {
            sum[l] = entries[0][l] * head;
        }
        let beside = entries[1..].iter().zip(&x[row + 1..]);
        for ((entry, x), product) in beside.zip(&mut product[row + 1..]) {
            for l in 0..LANES {
                sum[l] += entry[l] * x;
                product[l] += entry[l] * head;
            }
        }
        for l in 0..LANES {
            product[row][l] += sum[l];
        }
    }
}

/// Scalar products.
#[inline(always)]
fn dot(x: &[f64], lanes: &[Lanes]) -> Lanes {
    let mut sum = [0.0; LANES];
    for (x, lanes) in x.iter().zip(lanes) {
        for l in 0..LANES {
            sum[l] += x * lanes[l];
        }
    }
    sum
}
