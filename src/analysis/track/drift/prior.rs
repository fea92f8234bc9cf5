//! The prior of a filter bank: laws of the coefficients, and members that differ in the fluctuation of the
//! residual force.
//!
//! All standard deviations are shares of the force (0.01: 1 %), temperatures in K, times in days.

use super::spells;
use serde::{Deserialize, Serialize};

/// Time constant of the slow fluctuation \[d\].
const SLOW_D: f64 = 25.0;
/// Standard deviation of the intercept: the baseline's own error and a start in the middle of a fluctuation.
const INTERCEPT_SD: f64 = 0.03;
/// Standard deviation of the state that slow filters have before the first reading.
const TRANSIENT_SD: f64 = 0.01;
/// Standard deviations of an unexplained yearly cycle: with a thermometer, with other rods, and with neither.
const YEARLY_SD: [f64; 3] = [0.002, 0.008, 0.12];
/// Probability that the residual force jumps in a period: with readings that resolve the day, and with
/// others.
const KICK: [f64; 2] = [0.002, 0.02];
/// Probability that the force changes again in a period after a change: once in three years of daily ones.
const AGAIN: f64 = 1e-3;
/// Law of the coefficient of the other rods' median beside a thermometer, and of its square \[per unit\].
const MEDIAN_SD: [f64; 2] = [0.7, 0.5];
/// Mean and standard deviation of that coefficient without a thermometer, and standard deviation of the square's.
const ONLY_MEDIAN: [f64; 3] = [0.5, 1.0, 0.5];

/// Law of one coefficient: normal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Coefficient {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
}

/// Fluctuation of the residual force as one member assumes it: two Ornstein-Uhlenbeck processes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Fluctuation {
    /// Variance of the first, in noise variances.
    pub variance: f64,
    /// Its time constant \[d\].
    pub memory_d: f64,
    /// Variance of the second, in noise variances.
    pub slow_variance: f64,
    /// Its time constant \[d\].
    pub slow_memory_d: f64,
    /// Prior probability of the member.
    pub probability: f64,
}

/// Least and largest credible typical error that records state.
const STATED_SD: [f64; 2] = [1e-5, 0.1];
/// Least noise of the force expected beforehand: a force fluctuates, and one reading of the temperature misses what a day does to it,
/// however well the frequencies are known. Less is learned in weeks; where a fluctuation is more than a hundred times what is expected,
/// a change would explain it better than any member.
const LEAST_NOISE_SD: f64 = 1.5e-3;

/// Prior of a bank before the first period.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BankPrior {
    /// Typical stated standard error of a period's ratio.
    pub stated_sd: f64,
    /// Standard deviation of the noise beforehand, s0.
    pub noise_sd: f64,
    /// Standard deviation of the intercept.
    pub intercept_sd: f64,
    /// One law per column.
    pub columns: Vec<Coefficient>,
    /// Members.
    pub members: Vec<Fluctuation>,
    /// Probability that the residual force jumps in a period.
    pub kick: f64,
    /// Probability that the force changes again in a period after a change.
    pub again: f64,
    /// Probabilities that spells of larger noise begin never, rarely and often.
    pub spells: [f64; 3],
}

/// Prior of the effect of temperature on one rod.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ThermalPrior {
    /// Mean of the slope of the ratio, -kappa E A alpha / N_0 \[1/K\].
    pub slope_mean_per_k: f64,
    /// Standard deviation of the slope \[1/K\].
    pub slope_sd_per_k: f64,
    /// Standard deviation of the curvature: by the material, and by wrong static parameters that bend the
    /// ratio \[1/K^2\].
    pub curvature_sd_per_k2: f64,
    /// True if readings are too sparse to resolve the day (more than four hours apart).
    pub is_sparse: bool,
}

impl BankPrior {
    fn of(stated_sd: f64, columns: Vec<Coefficient>, members: Vec<Fluctuation>, kick: f64) -> Self {
        Self {
            stated_sd: believable(stated_sd),
            noise_sd: believable(stated_sd).max(LEAST_NOISE_SD),
            intercept_sd: INTERCEPT_SD,
            columns,
            members,
            kick,
            again: AGAIN,
            spells: spells::PRIOR,
        }
    }

    /// Thermometer: filters of its readings, curvature, two transients, a yearly pair.
    ///
    /// The columns are those of [`super::Regressors::thermal`]. The slope's mean is put on the filter of six hours.
    pub fn thermal(stated_sd: f64, thermal: ThermalPrior) -> Self {
        let slope = thermal.slope_sd_per_k.abs();
        let filters = [1.0, 1.0, 1.0, 0.4, 0.3, 0.3];
        let mut columns: Vec<Coefficient> = filters.iter().map(|share| centred(share * slope)).collect();
        columns[1].mean = thermal.slope_mean_per_k;
        columns.push(centred(thermal.curvature_sd_per_k2));
        columns.extend([centred(TRANSIENT_SD); 2]);
        columns.extend([centred(YEARLY_SD[0]); 2]);
        Self::of(
            stated_sd,
            columns,
            beside_a_cause(),
            KICK[usize::from(thermal.is_sparse)],
        )
    }

    /// A force without effect of temperature: a yearly pair.
    pub fn unmoved(stated_sd: f64) -> Self {
        Self::of(
            stated_sd,
            vec![centred(YEARLY_SD[0]); 2],
            beside_a_cause(),
            KICK[0],
        )
    }

    /// Thermometer and other rods: the columns of [`BankPrior::thermal`], then the median of the other rods' ratios and its
    /// square.
    pub fn thermal_and_peers(stated_sd: f64, thermal: ThermalPrior) -> Self {
        let mut prior = Self::thermal(stated_sd, thermal);
        prior.columns.extend(MEDIAN_SD.map(centred));
        prior
    }

    /// Other rods only: their median, its square, a yearly pair.
    pub fn peers(stated_sd: f64) -> Self {
        let [mean, sd, square_sd] = ONLY_MEDIAN;
        let yearly = centred(YEARLY_SD[1]);
        let columns = vec![Coefficient { mean, sd }, centred(square_sd), yearly, yearly];
        Self::of(stated_sd, columns, beside_other_rods(), KICK[1])
    }

    /// The rod's own data only: a yearly pair, and members that allow for the weather.
    pub fn blind(stated_sd: f64) -> Self {
        let columns = vec![centred(YEARLY_SD[2]); 2];
        // Its evidence is of weather, most of the time.
        Self {
            again: 0.0,
            ..Self::of(stated_sd, columns, beside_nothing(), KICK[0])
        }
    }

    /// Sets readings as sparse or dense.
    pub(super) fn set_sparse(&mut self, is_sparse: bool) {
        self.kick = KICK[usize::from(is_sparse)];
    }
}

/// Limits a stated error so that it can scale a prior.
fn believable(stated_sd: f64) -> f64 {
    if stated_sd.is_finite() {
        stated_sd.clamp(STATED_SD[0], STATED_SD[1])
    } else {
        STATED_SD[1]
    }
}

fn centred(sd: f64) -> Coefficient {
    Coefficient { mean: 0.0, sd }
}

/// Members where most of the fluctuation has a measured cause: white noise, and 16 with memory.
fn beside_a_cause() -> Vec<Fluctuation> {
    let white = Fluctuation {
        variance: 0.0,
        memory_d: 1.0,
        slow_variance: 0.0,
        slow_memory_d: SLOW_D,
        probability: 0.3,
    };
    let remembers = [0.5, 2.0, 8.0, 32.0].into_iter().flat_map(|variance| {
        [1.0, 2.5, 7.0, SLOW_D].map(|memory_d| Fluctuation {
            variance,
            memory_d,
            slow_variance: if memory_d < SLOW_D { 0.1 * variance } else { 0.0 },
            slow_memory_d: SLOW_D,
            probability: 0.7 / 16.0,
        })
    });
    std::iter::once(white).chain(remembers).collect()
}

/// Members with other rods only: differences of the masonry between rods wander for weeks to months, by
/// little or by much.
fn beside_other_rods() -> Vec<Fluctuation> {
    const SLOW: [(f64, f64); 3] = [(0.1, 30.0), (1.0, 50.0), (10.0, 80.0)];
    let wanders = |member: &Fluctuation| {
        let member = *member;
        SLOW.map(|(slow_variance, slow_memory_d)| Fluctuation {
            slow_variance,
            slow_memory_d,
            probability: member.probability / SLOW.len() as f64,
            ..member
        })
    };
    let members = beside_a_cause();
    let mut members: Vec<Fluctuation> = members
        .iter()
        .filter(|member| member.memory_d < SLOW_D)
        .flat_map(wanders)
        .collect();
    let total: f64 = members.iter().map(|member| member.probability).sum();
    members.iter_mut().for_each(|member| member.probability /= total);
    members
}

/// Members with the rod's own data only: weather of days, and a wander over weeks, of less or equal size.
fn beside_nothing() -> Vec<Fluctuation> {
    let variances = (0..6).map(|power| libm::exp2(2.0 * f64::from(power)));
    let of = |variance: f64| {
        [1.0, 3.0, 8.0].into_iter().flat_map(move |memory_d| {
            [0.1, 1.0].map(|share| Fluctuation {
                variance,
                memory_d,
                slow_variance: share * variance,
                slow_memory_d: SLOW_D,
                probability: 1.0 / 36.0,
            })
        })
    };
    variances.flat_map(of).collect()
}
