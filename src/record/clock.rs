//! The line through the stamps: the sample rate, its standard error, and stamps that stray from it.
//!
//! Least squares where all stamps scatter alike. Where some stray, a Huber fit started at the median slope between
//! the two halves (Theil's incomplete method), so that a stamp a second late moves the rate no more than one a
//! little late. The standard error is that of the fit, larger where the scatter hangs together in time.

/// Stamps further from the line than this many standard deviations of the others make the fit robust.
const OUTLIER: f64 = 4.0;
/// Huber's constant: 95 % efficient where the scatter is Gaussian.
const HUBER: f64 = 1.345;
/// The standard deviation over the median of the absolute values, for a Gaussian.
pub(super) const GAUSSIAN: f64 = 1.4826;
/// Stretches of time whose sums of scores tell scatter that hangs together, and the ratio of variances that is none of chance
/// (one in 200 with the dozen degrees of freedom that the lever arms leave).
const STRETCHES: usize = 24;
const TOGETHER: f64 = 2.5;
/// Relative standard deviation of a declared rate: the tolerance of a common quartz.
const QUARTZ: f64 = 5e-5;
/// A measured rate surer than this is left as it is.
const SURE: f64 = 1e-7;

/// A straight line through stamps over sample numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Line {
    /// Nanoseconds a sample.
    pub slope: f64,
    /// The line at sample 0, from the first stamp \[ns\].
    pub start: f64,
    /// Standard deviation of the stamps about the line \[ns\], those that stray left out.
    pub scatter: f64,
    /// Relative standard error of the slope, widened for few stamps so that twice of it holds in 95 of 100.
    pub slope_sd: f64,
}

impl Line {
    /// How far a stamp lies behind the line \[ns\].
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
        // Half a nanosecond is what rounding leaves of exact stamps.
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

/// How many times the variance of the slope is that of scatter without memory; 1 where chance explains it.
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
/// A measured rate that is sure stands, and so does one that contradicts the declared rate. `stamps` is how many it was
/// measured with: two tell no scatter, so the difference itself is the error.
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

/// The middle of some numbers.
pub(super) fn median(numbers: &mut [f64]) -> f64 {
    if numbers.is_empty() {
        return f64::NAN;
    }
    let middle = numbers.len() / 2;
    *numbers.select_nth_unstable_by(middle, f64::total_cmp).1
}
