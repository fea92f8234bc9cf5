//! Patterns of frequencies: ratios n G_n that a tensioned beam on rotational springs can produce, at any point and on a fixed grid.

use crate::rod::beam::exact::{self, Support};
use crate::rod::beam::forward::MAX_MODES;
use std::f64::consts::PI;
use std::sync::{LazyLock, OnceLock};

/// Points of the grid along tension, and along each support.
pub(super) const TENSIONS: usize = 64;
const FIXITIES: usize = 13;

/// A point of the pattern space: tension u and fixities left and right, each from 0 to 1.
///
/// lambda = u / (10 (1 - u)), from the string (0) to the beam without tension (1); fixity
/// k / (k + sqrt(EI N) + EI / l), from hinge to clamp at any tension.
pub(super) type Point = [f64; 3];

/// n G_n of some modes, counted from zero, at a point, up to a common factor, and their wavenumbers; zero for the others. Wavenumbers
/// `near`, zero where none is known, save time.
pub(super) fn pattern(
    modes: impl Iterator<Item = usize>,
    point: Point,
    near: &[f64; MAX_MODES],
) -> [[f64; MAX_MODES]; 2] {
    let u = point[0].clamp(1e-7, 1.0 - 1e-4);
    let lambda = 0.1 * u / (1.0 - u);
    let supports = [point[1], point[2]].map(|fixity| {
        let stiffness = fixity / (1.0 - fixity) * (1.0 + 1.0 / lambda);
        Support::from_stiffness(stiffness, 1.0)
    });
    let tension = 1.0 / (lambda * lambda);
    let [mut pattern, mut wavenumbers] = [[0.0; MAX_MODES]; 2];
    for i in modes {
        let wavenumber = match near[i] {
            0.0 => exact::wavenumber(i + 1, tension, &supports),
            near => exact::wavenumber_near(i + 1, tension, &supports, near),
        };
        pattern[i] = wavenumber / PI * (1.0 + (lambda * wavenumber).powi(2)).sqrt();
        wavenumbers[i] = wavenumber;
    }
    [pattern, wavenumbers]
}

/// Pairs of fixities of the grid; a beam and its mirror image have the same frequencies.
pub(super) static LINES: LazyLock<Vec<[usize; 2]>> = LazyLock::new(|| {
    let pairs = (0..FIXITIES).flat_map(|left| (left..FIXITIES).map(move |right| [left, right]));
    pairs.collect()
});

/// A point of the grid.
pub(super) fn at(fixities: [usize; 2], u: f64) -> Point {
    let [left, right] = fixities.map(|i| i as f64 / (FIXITIES - 1) as f64);
    [u, left, right]
}

/// Tension is denser towards the string, where tie-rods are.
pub(super) fn grid_tension(i: f64) -> f64 {
    (i / (TENSIONS - 1) as f64).powi(2)
}

/// n G_n of one mode, counted from zero, along tension, string first, for each of [`LINES`]: solved once, mode by mode, since most rods
/// show three.
pub(super) fn grid(mode: usize) -> &'static [[f64; TENSIONS]] {
    static GRID: [OnceLock<Vec<[f64; TENSIONS]>>; MAX_MODES] = [const { OnceLock::new() }; MAX_MODES];
    GRID[mode].get_or_init(|| {
        let line = |&fixities: &[usize; 2]| {
            let (mut near, mut before) = ([0.0; MAX_MODES], 0.0);
            std::array::from_fn(|i| {
                let point = at(fixities, grid_tension(i as f64));
                let [pattern, wavenumbers] = pattern(std::iter::once(mode), point, &near);
                let here = wavenumbers[mode];
                // On the straight line through the last two.
                near[mode] = if i > 0 { 2.0 * here - before } else { here };
                before = here;
                pattern[mode]
            })
        };
        LINES.iter().map(line).collect()
    })
}
