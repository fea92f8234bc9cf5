//! Responses of every particle's frequencies to changes of every kind and size.

use super::Kind;
use crate::rod::beam::Quantity;
use crate::rod::beam::forward::{ForwardModel, MAX_MODES};
use nalgebra::{DMatrix, DVector};

/// Most particles kept, evenly from those of the baseline.
const PARTICLES: usize = 192;

/// Spacing of the nodes in asinh(x / unit), with the unit a share of the smallest scale of sizes: dense where changes are small.
const SPACING: f64 = 0.3;
const UNIT: f64 = 0.4;

/// Relative error of the model's response to a change, in discrepancies of its frequencies, and its least: a
/// frequency's discrepancy comes from masses or a section missing in the model, and these change the response
/// by a similar share.
const ANSWER: f64 = 1.5;
const LEAST_ERROR: f64 = 0.003;

/// One entry per mode order from 1; those that are not used are zero.
pub(super) type Modes = [f64; MAX_MODES];

/// Responses to one kind of change; to that of one side, where there are two.
#[derive(Debug, Clone)]
pub(super) struct Curve {
    pub kind: Kind,
    /// Sizes, ascending.
    pub nodes: Vec<f64>,
    /// Prior probability of a size between a node and the next.
    pub mass: Vec<f64>,
    /// Shifts of ln f, node by node and within a node particle by particle.
    pub answers: Vec<Modes>,
    /// Number of particles; one if all respond alike.
    pub count: usize,
    /// Mean response at each node.
    pub means: Vec<Modes>,
}

/// Responses of one rod to changes of every kind, ready for its shifts.
#[derive(Debug, Clone)]
pub struct Alternatives {
    pub(super) curves: Vec<Curve>,
    /// Relative error of a response, per order from 1.
    pub(super) error: Modes,
    /// Number of mode orders of the model.
    pub(super) modes: usize,
}

impl Alternatives {
    /// Prepares. `particles` row-major as in a baseline, `discrepancy` relative, per mode order from 1.
    /// Particles without a model answer to every change are left out; `None` if that leaves none.
    pub fn new(particles: &[f64], model: &dyn ForwardModel, discrepancy: &[f64]) -> Option<Self> {
        let parameterisation = model.parameterisation();
        let width = parameterisation.len();
        let modes = model.modes().min(MAX_MODES);
        let count = particles.len() / width;
        let kept = count.min(PARTICLES);
        let thetas: Vec<&[f64]> = (0..kept)
            .filter_map(|i| particles.chunks_exact(width).nth(i * count / kept))
            .collect();
        let at = |quantity| parameterisation.index(quantity);
        let rigidity = at(Quantity::YoungsModulus).or(at(Quantity::FlexuralRigidity))?;
        let (left, right) = (at(Quantity::SpringLeft)?, at(Quantity::SpringRight)?);
        let force = at(Quantity::AxialForce)?;
        let scaled = |kind: Kind, entries: &[usize], power: f64, mass: f64| {
            let nodes = nodes(kind);
            let mut moved = Vec::with_capacity(nodes.len() * thetas.len() * width);
            for x in nodes.iter().chain([&0.0]) {
                for theta in &thetas {
                    let first = moved.len();
                    moved.extend_from_slice(theta);
                    entries
                        .iter()
                        .for_each(|entry| moved[first + entry] *= libm::exp(power * x));
                }
            }
            let mut logs = vec![0.0; moved.len() / width * modes];
            model.frequencies_of_many(&moved, modes, &mut logs);
            logs.iter_mut().for_each(|f| *f = libm::log(*f));
            let (logs, still) = logs.split_at(nodes.len() * thetas.len() * modes);
            let mut answers = Vec::with_capacity(nodes.len() * thetas.len());
            for (x, logs) in nodes.iter().zip(logs.chunks_exact(thetas.len() * modes)) {
                for (log, still) in logs.chunks_exact(modes).zip(still.chunks_exact(modes)) {
                    let mut answer = [0.0; MAX_MODES];
                    for n in 0..modes {
                        answer[n] = log[n] - still[n] - 0.5 * mass * x;
                    }
                    answers.push(answer);
                }
            }
            (kind, nodes, answers)
        };
        let mut curves = vec![
            scaled(Kind::Force, &[force], 1.0, 0.0),
            scaled(Kind::BothSupports, &[left, right], 1.0, 0.0),
            scaled(Kind::OneSupport, &[left], 1.0, 0.0),
            scaled(Kind::OneSupport, &[right], 1.0, 0.0),
            scaled(Kind::Modulus, &[rigidity], 1.0, 0.0),
            scaled(Kind::Section, &[rigidity], 4.0, 2.0),
        ];
        let known: Vec<usize> = (0..thetas.len())
            .filter(|&i| {
                curves.iter().all(|(_, nodes, answers)| {
                    (0..nodes.len()).all(|k| answers[k * thetas.len() + i].iter().all(|r| r.is_finite()))
                })
            })
            .collect();
        if known.is_empty() {
            return None;
        }
        for (_, _, answers) in &mut curves {
            *answers = answers
                .chunks_exact(thetas.len())
                .flat_map(|answers| known.iter().map(|&i| answers[i]))
                .collect();
        }
        // f goes with mass^-1/2 in every mode of every rod.
        let masses = nodes(Kind::Mass);
        let answers = masses
            .iter()
            .map(|x| std::array::from_fn(|n| if n < modes { -0.5 * x } else { 0.0 }))
            .collect();
        curves.push((Kind::Mass, masses, answers));
        Some(Self {
            curves: curves.into_iter().map(|curve| Curve::new(curve, modes)).collect(),
            error: std::array::from_fn(|n| {
                let stated = discrepancy.get(n).copied().unwrap_or(0.0);
                (ANSWER * stated).max(LEAST_ERROR)
            }),
            modes,
        })
    }

    /// The mean shift of ln f by ln(N / N_0) = `u`, straight between nodes.
    pub(super) fn of_force(&self, u: f64) -> Modes {
        let Some(curve) = self.curves.first() else {
            return [0.0; MAX_MODES];
        };
        let (k, share) = curve.place(u);
        std::array::from_fn(|n| curve.means[k][n] + share * (curve.means[k + 1][n] - curve.means[k][n]))
    }

    /// Covariance of that shift, by the particles' spread and the model's own error, per order from 1.
    pub(super) fn error_of_force(&self, u: f64) -> DMatrix<f64> {
        let mean = self.of_force(u);
        let mut error = DMatrix::from_fn(MAX_MODES, MAX_MODES, |a, b| {
            if a == b {
                (self.error[a] * mean[a]).powi(2)
            } else {
                0.0
            }
        });
        let Some(curve) = self.curves.first() else {
            return error;
        };
        let (k, share) = curve.place(u);
        let answers = |k: usize| curve.answers[k * curve.count..][..curve.count].iter();
        for (low, high) in answers(k).zip(answers(k + 1)) {
            let off = DVector::from_fn(MAX_MODES, |n, _| low[n] + share * (high[n] - low[n]) - mean[n]);
            error.ger((curve.count as f64).recip(), &off, &off, 1.0);
        }
        error
    }
}

impl Curve {
    /// Node below a size, and the share of the way to the next.
    fn place(&self, x: f64) -> (usize, f64) {
        let last = self.nodes.len() - 2;
        let k = self
            .nodes
            .partition_point(|node| *node <= x)
            .saturating_sub(1)
            .min(last);
        (k, (x - self.nodes[k]) / (self.nodes[k + 1] - self.nodes[k]))
    }

    fn new((kind, nodes, answers): (Kind, Vec<f64>, Vec<Modes>), modes: usize) -> Self {
        let (low, high, _) = kind.sizes();
        let below = |x: f64| kind.probability_below(x);
        let whole = below(high) - below(low);
        let mass = nodes
            .windows(2)
            .map(|pair| (below(pair[1]) - below(pair[0])) / whole)
            .collect();
        let count = answers.len() / nodes.len();
        let means = answers
            .chunks_exact(count)
            .map(|answers| {
                let mut mean = [0.0; MAX_MODES];
                for n in 0..modes {
                    mean[n] = answers.iter().map(|answer| answer[n]).sum::<f64>() / count as f64;
                }
                mean
            })
            .collect();
        Self {
            kind,
            nodes,
            mass,
            answers,
            count,
            means,
        }
    }
}

/// Sizes at which responses are computed: both ends, zero, and evenly in asinh(x / unit) between.
fn nodes(kind: Kind) -> Vec<f64> {
    let (low, high, scale) = kind.sizes();
    let unit = UNIT * kind.creep().unwrap_or(scale);
    let side = |end: f64| {
        let reach = libm::asinh(end.abs() / unit);
        let steps = (reach / SPACING).ceil().max(0.0);
        (1..=steps as usize).map(move |k| end.signum() * unit * libm::sinh(reach * k as f64 / steps))
    };
    let mut nodes: Vec<f64> = side(low).collect();
    nodes.reverse();
    nodes.push(0.0);
    nodes.extend(side(high).filter(|_| high > 0.0));
    nodes
}
