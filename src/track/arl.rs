//! Average run lengths of one-sided and two-sided CUSUM charts from the integral equation.

/// Average run length of the one-sided chart C = max(0, C + r - k), alarm above h, r ~ N(`shift`, 1), from zero.
pub fn one_sided(_k: f64, _h: f64, _shift: f64) -> f64 {
    todo!()
}

/// Average run length of the two-sided chart: 1 / L = 1 / L+ + 1 / L-.
pub fn two_sided(_k: f64, _h: f64, _shift: f64) -> f64 {
    todo!()
}
