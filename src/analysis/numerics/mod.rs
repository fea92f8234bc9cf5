//! Numerical tools independent of rods: they import from no other module.
//!
//! * [`random`]      seeds and counter-based streams
//! * `exp`           e^x and ln(1 + x) of many numbers at once
//! * `extremes`    least and largest of many numbers
//! * `simd`          inner loops on the widest vectors a processor has
//! * [`orthogonal`]  orthogonal polynomials and their quadratures
//! * [`optimum`]     minima of smooth functions
//! * [`diagnostics`] Monte Carlo errors, effective sample size, tests of calibration
//! * `tail`          tails and quantiles of the normal and of chi-square
//! * `json_number`   numbers that may not be finite, out of JSON

pub mod diagnostics;
pub(crate) mod exp;
pub(crate) mod extremes;
pub(crate) mod json_number;
pub mod optimum;
pub mod orthogonal;
pub mod random;
pub(crate) mod simd;
pub(crate) mod tail;
