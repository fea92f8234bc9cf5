//! Orthonormal polynomials by their three-term recurrence, and the Gauss rules that belong to them.
//!
//! `sqrt(beta_{k+1}) p_{k+1}(x) = (x - alpha_k) p_k(x) - sqrt(beta_k) p_{k-1}(x)`, `p_0 = 1`, for a
//! probability measure (Gautschi, Orthogonal Polynomials: Computation and Approximation, 2004).

/// The recurrence of a family of orthonormal polynomials.
#[derive(Debug, Clone, PartialEq)]
pub struct Recurrence {
    alpha: Vec<f64>,
    /// sqrt(beta_0 = 1), sqrt(beta_1), ...
    root_beta: Vec<f64>,
}

/// A Gauss rule: nodes ascending, weights of sum one.
#[derive(Debug, Clone, PartialEq)]
pub struct Gauss {
    /// Nodes.
    pub nodes: Vec<f64>,
    /// Weights.
    pub weights: Vec<f64>,
}

impl Recurrence {
    /// Legendre polynomials: the uniform measure on -1 to 1. Good for degrees up to `degree`.
    pub fn legendre(degree: usize) -> Self {
        Self::symmetric(degree, |k| k * k / (4.0 * k * k - 1.0))
    }

    /// Probabilists' Hermite polynomials `He_k / sqrt(k!)`: the standard normal measure.
    pub fn hermite(degree: usize) -> Self {
        Self::symmetric(degree, |k| k)
    }

    fn symmetric(degree: usize, beta: impl Fn(f64) -> f64) -> Self {
        let root_beta = (0..=degree + 1).map(|k| if k == 0 { 1.0 } else { beta(k as f64).sqrt() });
        Self {
            alpha: vec![0.0; degree + 1],
            root_beta: root_beta.collect(),
        }
    }

    /// The polynomials of a discrete measure with these nodes and weights (which need not sum to one), by
    /// Stieltjes' procedure; `degree` is less than the number of nodes.
    pub fn discrete(nodes: &[f64], weights: &[f64], degree: usize) -> Self {
        let mass: f64 = weights.iter().sum();
        let mut before = vec![0.0; nodes.len()];
        let mut current = vec![1.0; nodes.len()];
        let (mut alpha, mut root_beta) = (Vec::new(), vec![1.0]);
        for _ in 0..=degree {
            let moment = |f: &dyn Fn(usize) -> f64| -> f64 {
                (0..nodes.len()).map(|i| weights[i] * f(i)).sum::<f64>() / mass
            };
            let a = moment(&|i| nodes[i] * current[i] * current[i]);
            let root = *root_beta.last().unwrap_or(&1.0);
            let next: Vec<f64> = (0..nodes.len())
                .map(|i| (nodes[i] - a) * current[i] - root * before[i])
                .collect();
            let norm = moment(&|i| next[i] * next[i]).sqrt();
            alpha.push(a);
            root_beta.push(norm);
            before = current;
            current = next.into_iter().map(|p| p / norm).collect();
        }
        Self { alpha, root_beta }
    }

    /// The polynomials of the standard normal truncated to `z > low`, from a fine discretisation.
    pub fn truncated_normal(low: f64, degree: usize) -> Self {
        // Beyond 12 standard deviations the weight is below 1e-31.
        let high = low.max(0.0) + 12.0;
        let low = low.max(-12.0);
        let fine = Self::legendre(200).gauss(200);
        let nodes: Vec<f64> = fine
            .nodes
            .iter()
            .map(|x| 0.5 * (low + high) + 0.5 * (high - low) * x)
            .collect();
        let density = |z: &f64| libm::exp(-0.5 * (z * z - low.max(0.0).powi(2)));
        let weights: Vec<f64> = nodes
            .iter()
            .zip(&fine.weights)
            .map(|(z, w)| w * density(z))
            .collect();
        Self::discrete(&nodes, &weights, degree)
    }

    /// Highest degree the recurrence reaches.
    pub fn degree(&self) -> usize {
        self.alpha.len() - 1
    }

    /// `p_0(x) ... p_{out.len() - 1}(x)` at `L` points at once.
    #[inline(always)]
    pub fn values<const L: usize>(&self, x: &[f64; L], out: &mut [[f64; L]]) {
        let mut before = [0.0; L];
        let mut current = [1.0; L];
        for (k, out) in out.iter_mut().enumerate() {
            *out = current;
            let (alpha, root, scale) = (self.alpha[k], self.root_beta[k], 1.0 / self.root_beta[k + 1]);
            for l in 0..L {
                let next = ((x[l] - alpha) * current[l] - root * before[l]) * scale;
                before[l] = current[l];
                current[l] = next;
            }
        }
    }

    /// Values and derivatives of `p_0 ... p_{values.len() - 1}` at `x`.
    pub fn values_and_slopes(&self, x: f64, values: &mut [[f64; 1]], slopes: &mut [[f64; 1]]) {
        self.values(&[x], values);
        for k in 0..slopes.len() {
            slopes[k][0] = match k {
                0 => 0.0,
                _ => {
                    let before = if k > 1 {
                        self.root_beta[k - 1] * slopes[k - 2][0]
                    } else {
                        0.0
                    };
                    let step = (x - self.alpha[k - 1]) * slopes[k - 1][0] + values[k - 1][0];
                    (step - before) / self.root_beta[k]
                }
            };
        }
    }

    /// `p_0(x) ... p_degree(x)`.
    pub fn at(&self, x: f64, degree: usize) -> Vec<f64> {
        let mut values = vec![[0.0]; degree + 1];
        self.values(&[x], &mut values);
        values.into_iter().map(|[v]| v).collect()
    }

    /// The Gauss rule of `points` points, `points <= degree + 1`: nodes are the eigenvalues of the Jacobi
    /// matrix, bisected by their Sturm counts; weights are `1 / sum p_k^2`.
    pub fn gauss(&self, points: usize) -> Gauss {
        let below = |x: f64| {
            let (mut negative, mut pivot) = (0, 1.0);
            for k in 0..points {
                let coupling = if k == 0 {
                    0.0
                } else {
                    self.root_beta[k] * self.root_beta[k]
                };
                pivot = self.alpha[k] - x - coupling / pivot;
                if pivot == 0.0 {
                    pivot = f64::MIN_POSITIVE;
                }
                negative += usize::from(pivot < 0.0);
            }
            negative
        };
        // Gershgorin's circles hold every eigenvalue.
        let reach = (0..points).map(|k| self.alpha[k].abs() + self.root_beta[k] + self.root_beta[k + 1]);
        let reach = reach.fold(0.0, f64::max);
        let nodes: Vec<f64> = (0..points)
            .map(|i| {
                let (mut low, mut high) = (-reach, reach);
                for _ in 0..80 {
                    let middle = 0.5 * (low + high);
                    if middle == low || middle == high {
                        // Neighbouring numbers: nothing lies between.
                        break;
                    }
                    if below(middle) > i {
                        high = middle;
                    } else {
                        low = middle;
                    }
                }
                0.5 * (low + high)
            })
            .collect();
        let weights = nodes
            .iter()
            .map(|&x| 1.0 / self.at(x, points - 1).iter().map(|p| p * p).sum::<f64>())
            .collect();
        Gauss { nodes, weights }
    }
}

/// All multi-indices of `dimensions` entries with a sum of at most `order`, by sum, then lexicographically.
pub fn total_degree(dimensions: usize, order: usize) -> Vec<Vec<usize>> {
    fn extend(prefix: &mut Vec<usize>, left: usize, rest: usize, out: &mut Vec<Vec<usize>>) {
        if left == 0 {
            if rest == 0 {
                out.push(prefix.clone());
            }
            return;
        }
        for degree in (0..=rest).rev() {
            prefix.push(degree);
            extend(prefix, left - 1, rest - degree, out);
            prefix.pop();
        }
    }
    let mut out = Vec::new();
    for sum in 0..=order {
        extend(&mut Vec::new(), dimensions, sum, &mut out);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gauss_rules_are_the_tabulated_ones() {
        // Abramowitz and Stegun, tables 25.4 and 25.10 (there for exp(-x^2): nodes times sqrt 2).
        let legendre = Recurrence::legendre(5).gauss(5);
        let expected = [-0.906_179_845_938_664, -0.538_469_310_105_683, 0.0];
        for (node, expected) in legendre.nodes.iter().zip(expected) {
            assert!((node - expected).abs() < 1e-15);
        }
        assert!((2.0 * legendre.weights[2] - 0.568_888_888_888_889).abs() < 1e-15);
        let hermite = Recurrence::hermite(6).gauss(6);
        let expected = [
            0.436_077_411_927_617,
            1.335_849_074_013_697,
            2.350_604_973_674_492,
        ];
        for (node, expected) in hermite.nodes[3..].iter().zip(expected) {
            assert!((node - expected * 2f64.sqrt()).abs() < 2e-15);
        }
    }

    #[test]
    fn gauss_rules_integrate_normal_moments() {
        let rule = Recurrence::hermite(10).gauss(10);
        for (power, moment) in [
            (2, 1.0),
            (4, 3.0),
            (6, 15.0),
            (8, 105.0),
            (18, 34_459_425.0),
            (7, 0.0),
        ] {
            let sum: f64 = rule
                .nodes
                .iter()
                .zip(&rule.weights)
                .map(|(z, w)| w * z.powi(power))
                .sum();
            assert!((sum - moment).abs() < 1e-13 * moment.max(1e3));
        }
    }

    #[test]
    fn a_barely_truncated_normal_has_hermite_polynomials_and_any_has_its_mean() {
        let (near, far) = (Recurrence::truncated_normal(-11.0, 8), Recurrence::hermite(8));
        for (a, b) in near.at(1.3, 8).iter().zip(far.at(1.3, 8)) {
            assert!((a - b).abs() < 1e-11);
        }
        // Mean of the normal truncated to z > 0: sqrt(2 / pi).
        let half = Recurrence::truncated_normal(0.0, 6).gauss(6);
        let mean: f64 = half.nodes.iter().zip(&half.weights).map(|(z, w)| z * w).sum();
        assert!((mean - (2.0 / std::f64::consts::PI).sqrt()).abs() < 1e-13);
        assert!(half.nodes.iter().all(|&z| z > 0.0));
    }

    #[test]
    fn derivatives_are_the_limits_of_differences() {
        let family = Recurrence::truncated_normal(-1.0, 9);
        let (mut p, mut d) = ([[0.0]; 9], [[0.0]; 9]);
        family.values_and_slopes(0.7, &mut p, &mut d);
        let (up, down) = (family.at(0.7 + 1e-6, 8), family.at(0.7 - 1e-6, 8));
        for k in 0..9 {
            assert!(((up[k] - down[k]) / 2e-6 - d[k][0]).abs() < 1e-7 * (1.0 + d[k][0].abs()));
        }
    }

    #[test]
    fn the_paper_has_462_terms() {
        let terms = total_degree(6, 5);
        assert_eq!(terms.len(), 462);
        assert_eq!(terms[0], [0; 6]);
        assert!(
            terms
                .windows(2)
                .all(|t| t[0].iter().sum::<usize>() <= t[1].iter().sum())
        );
    }
}
