//! The line through the stamps: the sample rate, its standard error, and stamps that stray from it.
//!
//! Least squares where all stamps scatter alike. Where some stray, a Huber fit started at the median slope between
//! the two halves (Theil's incomplete method), so that a stamp a second late moves the rate no more than one a
//! little late. The standard error is that of the fit, larger where the scatter hangs together in time.

/// Distance from the line, in standard deviations of the other stamps, that makes the fit robust.
const OUTLIER: f64 = 4.0;
/// Huber's constant: 95 % efficient where the scatter is Gaussian.
const HUBER: f64 = 1.345;
/// The standard deviation over the median of the absolute values, for a Gaussian.
pub(super) const GAUSSIAN: f64 = 1.4826;
/// Number of stretches of time whose sums of scores reveal correlated scatter, and the ratio of variances
/// that chance exceeds once in 200 (with the dozen degrees of freedom that the lever arms leave).
const STRETCHES: usize = 24;
const TOGETHER: f64 = 2.5;
/// Relative standard deviation of a declared rate: the tolerance of a common quartz.
const QUARTZ: f64 = 5e-5;
/// Relative standard error below which a measured rate is used alone.
const SURE: f64 = 1e-7;

/// A straight line through stamps over sample numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Line {
    /// Nanoseconds per sample.
    pub slope: f64,
    /// Value at sample 0, from the first stamp \[ns\].
    pub start: f64,
    /// Standard deviation of the stamps about the line \[ns\], strays left out.
    pub scatter: f64,
    /// Relative standard error of the slope, widened for few stamps so that twice it is exceeded in 5 of 100.
    pub slope_sd: f64,
}

impl Line {
    /// Lateness of a stamp against the line \[ns\].
    pub fn late(&self, (number, time): (f64, f64)) -> f64 {
        time - self.start - self.slope * number
    }
}

/// Fits the line; two points at least, ascending in their sample numbers.
pub(super) fn fit<I: Iterator<Item = (f64, f64)>>(points: impl Fn() -> I) -> Line {
    let (count, sum_k, sum_t) = points().fold((0.0, 0.0, 0.0), |(n, k, t), point| {
        (n + 1.0, k + point.0, t + point.1)
    });
    let (mean_k, mean_t) = (sum_k / count, sum_t / count);
    let (mut kk, mut kt) = (0.0, 0.0);
    for (k, t) in points() {
        kk += (k - mean_k) * (k - mean_k);
        kt += (k - mean_k) * (t - mean_t);
    }
    let slope = kt / kk;
    let mut line = Line {
        slope,
        start: mean_t - slope * mean_k,
        scatter: 0.0,
        slope_sd: 0.0,
    };
    let (squares, largest) = points().fold((0.0, 0.0f64), |(sum, most), point| {
        let late = line.late(point);
        (sum + late.powi(2), most.max(late.abs()))
    });
    line.scatter = (squares / (count - 2.0).max(1.0)).sqrt();
    let mut bound = f64::INFINITY;
    let mut variance = line.scatter.powi(2) / kk;
    // A scatter of nanoseconds is the rounding of the stamps.
    if largest > 2.0 && largest > OUTLIER * spread(&line, &points) {
        line = robust(line, &points);
        bound = HUBER * line.scatter;
        variance = robust_variance(&line, &points, bound, (count, mean_k, kk));
    }
    variance *= together(&line, &points, bound, (count, mean_k));
    line.slope_sd = variance.sqrt() / line.slope * student(count - 2.0);
    line
}

/// Robust standard deviation about the line.
fn spread<I: Iterator<Item = (f64, f64)>>(line: &Line, points: &impl Fn() -> I) -> f64 {
    let mut off: Vec<f64> = points().map(|point| line.late(point).abs()).collect();
    GAUSSIAN * median(&mut off)
}

/// Huber's fit by weights, from the median slope.
fn robust<I: Iterator<Item = (f64, f64)>>(least_squares: Line, points: &impl Fn() -> I) -> Line {
    let count = points().count();
    let half = count / 2;
    let mut slopes: Vec<f64> = points()
        .zip(points().skip(half))
        .map(|(a, b)| (b.1 - a.1) / (b.0 - a.0))
        .collect();
    let mut line = Line {
        slope: median(&mut slopes),
        ..least_squares
    };
    let mut starts: Vec<f64> = points().map(|(k, t)| t - line.slope * k).collect();
    line.start = median(&mut starts);
    for _ in 0..30 {
        // Rounding leaves half a nanosecond of error in exact stamps.
        line.scatter = spread(&line, points).max(0.5);
        let bound = HUBER * line.scatter;
        let weight = |point| (bound / f64::abs(line.late(point))).min(1.0);
        let (w, k, t) = points().fold((0.0, 0.0, 0.0), |(w, k, t), point| {
            let own = weight(point);
            (w + own, k + own * point.0, t + own * point.1)
        });
        let (mean_k, mean_t) = (k / w, t / w);
        let (mut kk, mut kt) = (0.0, 0.0);
        for point in points() {
            let own = weight(point) * (point.0 - mean_k);
            kk += own * (point.0 - mean_k);
            kt += own * (point.1 - mean_t);
        }
        let slope = kt / kk;
        let moved = (slope - line.slope).abs() * count as f64;
        line.slope = slope;
        line.start = mean_t - slope * mean_k;
        if moved < 1e-6 * line.scatter {
            break;
        }
    }
    line
}

/// Variance of the slope of Huber's fit (Huber 1981, section 7.6).
fn robust_variance<I: Iterator<Item = (f64, f64)>>(
    line: &Line,
    points: &impl Fn() -> I,
    bound: f64,
    (count, _, kk): (f64, f64, f64),
) -> f64 {
    let (squares, inside) = points().fold((0.0, 0.0), |(sum, inside), point| {
        let late = line.late(point);
        let is_inside = f64::from(u8::from(late.abs() < bound));
        (sum + late.clamp(-bound, bound).powi(2), inside + is_inside)
    });
    let share = (inside / count).max(0.05);
    squares / (count - 2.0).max(1.0) / (share * share) / kk
}

/// Factor on the variance of the slope over that of uncorrelated scatter; 1 where chance explains it.
fn together<I: Iterator<Item = (f64, f64)>>(
    line: &Line,
    points: &impl Fn() -> I,
    bound: f64,
    (count, mean_k): (f64, f64),
) -> f64 {
    let stretch = (count / STRETCHES as f64).ceil() as usize;
    if stretch < 4 {
        return 1.0;
    }
    let (mut of_stretches, mut of_points, mut sum) = (0.0, 0.0, 0.0);
    for (i, point) in points().enumerate() {
        if i % stretch == 0 {
            of_stretches += f64::powi(sum, 2);
            sum = 0.0;
        }
        let score = (point.0 - mean_k) * line.late(point).clamp(-bound, bound);
        sum += score;
        of_points += score * score;
    }
    of_stretches += sum * sum;
    let ratio = of_stretches / of_points;
    if ratio > TOGETHER { ratio } else { 1.0 }
}

/// Student's 97.5 % point over the Gaussian one.
fn student(freedom: f64) -> f64 {
    match freedom {
        ..1.5 => 6.48,
        1.5..2.5 => 2.20,
        2.5..3.5 => 1.62,
        3.5..4.5 => 1.42,
        _ => 1.0 + 1.45 / freedom,
    }
}

/// A measured rate and a declared one \[Hz\], each by its precision: the rate and its relative standard error.
///
/// A precise measured rate is used alone, and so is one that contradicts the declared rate. `stamps` is the
/// number of stamps behind it: two have no scatter, so the difference itself is the error.
pub(super) fn weigh(measured_hz: f64, sd: f64, declared_hz: f64, stamps: usize) -> (f64, f64) {
    let difference = declared_hz / measured_hz - 1.0;
    if difference.abs() < 1e-9 {
        return (declared_hz, if sd < SURE { sd } else { combined(sd) });
    }
    if stamps == 2 {
        return (measured_hz, difference.abs());
    }
    if sd < SURE || difference.abs() > 3.0 * sd.hypot(QUARTZ) {
        return (measured_hz, sd);
    }
    let weight = sd * sd / (sd * sd + QUARTZ * QUARTZ);
    (measured_hz * (1.0 + weight * difference), combined(sd))
}

fn combined(sd: f64) -> f64 {
    sd * QUARTZ / sd.hypot(QUARTZ)
}

/// Median of some numbers.
pub(super) fn median(numbers: &mut [f64]) -> f64 {
    if numbers.is_empty() {
        return f64::NAN;
    }
    let middle = numbers.len() / 2;
    *numbers.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A random generator: xorshift, with the sum of twelve uniforms for a Gaussian.
    struct Noise(u64);

    impl Noise {
        fn uniform(&mut self) -> f64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        }

        fn gaussian(&mut self) -> f64 {
            (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
        }
    }

    /// Blocks of `size` samples at 100 Hz, 60 s of them, their stamps off by `off` \[s\].
    fn blocks(size: usize, mut off: impl FnMut(usize) -> f64) -> Vec<(f64, f64)> {
        (0..6000 / size)
            .map(|i| {
                let number = (i * size) as f64;
                (number, ((number * 0.01 + off(i)) * 1e9).round())
            })
            .collect()
    }

    fn rate_error(points: &[(f64, f64)]) -> (f64, f64) {
        let line = fit(|| points.iter().copied());
        (line.slope / 1e7 - 1.0, line.slope_sd)
    }

    #[test]
    fn the_stated_error_of_the_rate_covers() {
        // The study's record: 60 s at 100 Hz in blocks of 32, stamps off by 2 ms. The standard error of a slope over n even points
        // is sigma sqrt(12) / (T sqrt(n)): 8.5 ppm.
        let mut noise = Noise(7);
        let (mut inside, mut squares, mut stated) = (0, 0.0, 0.0);
        let trials = 2000;
        for _ in 0..trials {
            let (error, sd) = rate_error(&blocks(32, |_| 2e-3 * noise.gaussian()));
            inside += usize::from(error.abs() < 1.96 * sd);
            squares += error * error;
            stated += sd;
        }
        let (actual, stated) = ((squares / trials as f64).sqrt(), stated / trials as f64);
        println!("rate: actual {actual:.2e}, stated {stated:.2e}, {inside} of {trials} inside");
        assert!((actual / 8.5e-6 - 1.0).abs() < 0.06, "{actual:e}");
        // Binomial: 95 % give or take three times 0.5 %; the widening for few degrees of freedom is an approximation.
        assert!(
            (0.93..0.966).contains(&(inside as f64 / trials as f64)),
            "{inside}"
        );
        assert!((stated / actual - 1.0).abs() < 0.08, "{stated:e} {actual:e}");
    }

    #[test]
    fn a_stamp_much_too_late_hardly_moves_the_rate() {
        let mut noise = Noise(11);
        let jitter: Vec<f64> = (0..400).map(|_| 2e-3 * noise.gaussian()).collect();
        let clean = rate_error(&blocks(32, |i| jitter[i])).0;
        let late = |i: usize| jitter[i] + if i == 150 { 0.4 } else { 0.0 };
        let (spoilt, sd) = rate_error(&blocks(32, late));
        // By the study 1.5 ppm; least squares makes it 172 at the end of the record.
        assert!((spoilt - clean).abs() < 3e-6, "{clean:e} {spoilt:e}");
        assert!(sd < 1.3e-5, "{sd:e}");
        // Exact stamps but one: the rate is exact.
        let (error, sd) = rate_error(&blocks(32, |i| if i == 20 { 3e-3 } else { 0.0 }));
        assert!(error.abs() < 2e-8 && sd < 2e-8, "{error:e} {sd:e}");
    }

    #[test]
    fn scatter_that_hangs_together_widens_the_error() {
        // Delays that wander: a first-order process over some twenty messages, 2 ms in all.
        let mut noise = Noise(3);
        let (mut inside, trials) = (0, 300);
        for _ in 0..trials {
            let mut state = 2e-3 * noise.gaussian();
            let (error, sd) = rate_error(&blocks(4, |_| {
                state = 0.95 * state + 2e-3 * (1.0f64 - 0.95 * 0.95).sqrt() * noise.gaussian();
                state
            }));
            inside += usize::from(error.abs() < 1.96 * sd);
        }
        // Taken as without memory, 25 % would be inside: the variance is 39 times as large.
        assert!(inside as f64 > 0.82 * f64::from(trials), "{inside} of {trials}");
    }

    #[test]
    fn a_declared_rate_counts_by_its_precision() {
        assert_eq!(weigh(100.0, 1e-5, 100.0, 100).0, 100.0);
        // Sure stamps win, and so do stamps that contradict.
        assert_eq!(weigh(100.01, 1e-9, 100.0, 100), (100.01, 1e-9));
        assert_eq!(weigh(100.05, 1e-5, 100.0, 100), (100.05, 1e-5));
        // Poor stamps give way to the quartz.
        let (rate, sd) = weigh(100.03, 3e-4, 100.0, 20);
        assert!(
            (rate - 100.0).abs() < 0.001 && (4.5e-5..5e-5).contains(&sd),
            "{rate} {sd}"
        );
        // Two stamps have no scatter.
        assert_eq!(weigh(100.02, 0.0, 100.0, 2).0, 100.02);
        assert!((weigh(100.02, 0.0, 100.0, 2).1 - 2e-4).abs() < 1e-6);
    }
}
