//! Adaptive random-walk Metropolis on the exact likelihood: a posterior that shares only prior and
//! forward model with ABC.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use tirante::analysis::inference::Observation;
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::forward::ForwardModel;
use tirante::analysis::rod::prior::RodPrior;

/// Draws of all quantities, row-major, after a quarter of the steps for adaptation.
pub fn metropolis(
    prior: &RodPrior,
    model: &dyn ForwardModel,
    observation: &Observation,
    discrepancy: f64,
    steps: usize,
    seed: u64,
) -> Vec<f64> {
    let free: Vec<usize> = (0..prior.priors().len())
        .filter(|&i| !prior.priors()[i].is_fixed())
        .collect();
    let d = free.len();
    let mut generator = random::stream(seed, 0);
    let modes = *observation.orders.last().unwrap();
    let mut frequencies = vec![0.0; modes];
    let mut theta = prior.centre();
    // Density of the logarithms: the Jacobian adds their sum.
    let mut log_density = |logs: &[f64], theta: &mut Vec<f64>| -> f64 {
        for (&i, log) in free.iter().zip(logs) {
            theta[i] = log.exp();
        }
        let mut sum = prior.log_density(theta) + logs.iter().sum::<f64>();
        if sum == f64::NEG_INFINITY || model.frequencies(theta, &mut frequencies).is_err() {
            return f64::NEG_INFINITY;
        }
        for ((&order, y0), sd) in observation
            .orders
            .iter()
            .zip(&observation.frequency_hz)
            .zip(&observation.sd_hz)
        {
            let y = frequencies[order - 1];
            let variance = sd * sd + (discrepancy * y).powi(2);
            sum -= 0.5 * (y - y0).powi(2) / variance + 0.5 * variance.ln();
        }
        sum
    };
    let mut logs: Vec<f64> = free.iter().map(|&i| theta[i].ln()).collect();
    let mut current = log_density(&logs, &mut theta);
    let mut mean = logs.clone();
    let mut covariance = vec![0.0; d * d];
    (0..d).for_each(|i| covariance[i * d + i] = 1e-4);
    let mut root = cholesky(&covariance, d);
    let mut scale = 1.0;
    let (burn, keep_every) = (steps / 4, 10);
    let mut kept = Vec::with_capacity((steps - burn) / keep_every * theta.len());
    for step in 0..steps {
        let z: Vec<f64> = (0..d).map(|_| StandardNormal.sample(&mut generator)).collect();
        let proposal: Vec<f64> = (0..d)
            .map(|i| logs[i] + scale * (0..=i).map(|j| root[i * d + j] * z[j]).sum::<f64>())
            .collect();
        let value = log_density(&proposal, &mut theta);
        let accept = generator.random::<f64>().ln() < value - current;
        if accept {
            (logs, current) = (proposal, value);
        }
        if step < burn {
            // Haario's adaptation of the covariance, Robbins and Monro's of the scale.
            let rate = 1.0 / (step as f64 + 2.0).powf(0.7);
            scale *= (rate * (if accept { 1.0 } else { 0.0 } - 0.234)).exp();
            for i in 0..d {
                for j in 0..d {
                    let square = (logs[i] - mean[i]) * (logs[j] - mean[j]);
                    covariance[i * d + j] += rate * (square - covariance[i * d + j]);
                }
            }
            for i in 0..d {
                mean[i] += rate * (logs[i] - mean[i]);
            }
            if step % 200 == 0 && step > 2000 {
                root = cholesky(&covariance, d);
            }
        } else if step % keep_every == 0 {
            for (&i, log) in free.iter().zip(&logs) {
                theta[i] = log.exp();
            }
            kept.extend_from_slice(&theta);
        }
    }
    kept
}

fn cholesky(a: &[f64], d: usize) -> Vec<f64> {
    let mut l = vec![0.0; d * d];
    for i in 0..d {
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| l[i * d + k] * l[j * d + k]).sum();
            if i == j {
                l[i * d + i] = (a[i * d + i] - sum).max(1e-14).sqrt();
            } else {
                l[i * d + j] = (a[i * d + j] - sum) / l[j * d + j];
            }
        }
    }
    l
}

/// Mean and standard deviation of one column.
pub fn moments(rows: &[f64], width: usize, column: usize) -> (f64, f64) {
    let values: Vec<f64> = rows.iter().skip(column).step_by(width).copied().collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let variance = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64;
    (mean, variance.sqrt())
}
