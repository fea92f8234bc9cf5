//! The Fourier coefficients of a whole record, and a band of them around one peak.

use super::Mask;
use crate::signal::spectrum::welch::transform;
use crate::signal::spectrum::window::line;
use crate::signal::spectrum::{Transforms, fast_length};
use rustfft::num_complex::Complex;
use std::ops::Range;

/// The Fourier coefficients `J_k = dt / sqrt(T) sum_t x_t e^(-2 pi i k t / n)` of a record less its
/// straight line, without taper: `|J_k|^2` is the two-sided raw periodogram \[unit^2/Hz\].
#[derive(Debug, Clone)]
pub struct Coefficients {
    /// Length of the stretch transformed, T \[s\]; line `k` lies at `k / T`.
    pub duration_s: f64,
    /// The coefficients from 0 Hz to the Nyquist frequency.
    pub lines: Vec<Complex<f64>>,
}

impl Coefficients {
    /// Transforms the first samples of a record; at most 2.5 % at its end is left out, so that the
    /// length is one the transform is fast at.
    pub fn of(transforms: &Transforms, fs_hz: f64, samples: &[f64]) -> Self {
        let n = fast_length(samples.len());
        let samples = &samples[..n];
        let plan = transforms.plan(n);
        let mut input = plan.make_input_vec();
        let mut lines = plan.make_output_vec();
        let mut scratch = plan.make_scratch_vec();
        let (mean, slope) = line(samples);
        let middle = 0.5 * (n as f64 - 1.0);
        for (i, (slot, x)) in input.iter_mut().zip(samples).enumerate() {
            *slot = x - (mean + slope * (i as f64 - middle));
        }
        transform(&*plan, &mut input, &mut lines, &mut scratch);
        let duration_s = n as f64 / fs_hz;
        let scale = 1.0 / (fs_hz * duration_s.sqrt());
        for value in &mut lines {
            *value *= scale;
        }
        Self { duration_s, lines }
    }

    /// The band `low_hz` to `high_hz` without masked lines; abscissae relative to its middle.
    ///
    /// Neighbouring lines are added up into one cell as long as the cell stays narrower than
    /// `width_hz` of its frequency; a zero keeps every line for itself. The likelihood's sums over
    /// lines need only each cell's number of lines, sum of coefficients and sum of powers wherever
    /// the response does not change across the cell, so that the cost stops growing with the length
    /// of the record.
    pub fn band(&self, low_hz: f64, high_hz: f64, masks: &[Mask], width_hz: impl Fn(f64) -> f64) -> Band {
        let Range { start: first, end } = self.range(low_hz, high_hz);
        let mut band = Band {
            duration_s: self.duration_s,
            middle_hz: 0.5 * (low_hz + high_hz),
            half_width_hz: 0.5 * (high_hz - low_hz),
            ..Band::default()
        };
        let mut k = first;
        while k < end {
            let start_hz = k as f64 / self.duration_s;
            let most = (width_hz(start_hz) * self.duration_s).max(1.0) as usize;
            let mut cell = Cell::default();
            for (line, value) in self.lines.iter().enumerate().take(end.min(k + most)).skip(k) {
                let f = line as f64 / self.duration_s;
                if is_masked(masks, f) {
                    continue;
                }
                cell.lines += 1.0;
                cell.frequency_hz += f;
                cell.re += value.re;
                cell.im += value.im;
                let power = value.norm_sqr();
                cell.power += power;
                band.largest = band.largest.max(power);
            }
            if cell.lines > 0.0 {
                cell.frequency_hz /= cell.lines;
                cell.x = (cell.frequency_hz - band.middle_hz) / band.half_width_hz;
                cell.floor = 1.0;
                band.push(&cell);
            }
            k += most;
        }
        band
    }

    /// Number of lines that [`Coefficients::band`] takes, whatever the width of its cells.
    pub fn count(&self, low_hz: f64, high_hz: f64, masks: &[Mask]) -> usize {
        let is_taken = |line: &usize| !is_masked(masks, *line as f64 / self.duration_s);
        self.range(low_hz, high_hz).filter(is_taken).count()
    }

    /// Lines between two frequencies, but neither 0 Hz nor the Nyquist line: their coefficients are real.
    fn range(&self, low_hz: f64, high_hz: f64) -> Range<usize> {
        let first = (low_hz * self.duration_s).ceil().max(1.0) as usize;
        let end = (high_hz * self.duration_s).floor().max(0.0) as usize + 1;
        first..end.min(self.lines.len().saturating_sub(1))
    }
}

fn is_masked(masks: &[Mask], f: f64) -> bool {
    masks.iter().any(|mask| mask.contains(f))
}

/// One or several neighbouring Fourier coefficients.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cell {
    /// Number of coefficients.
    pub lines: f64,
    /// Their mean frequency \[Hz\].
    pub frequency_hz: f64,
    /// Frequency scaled to -1 to 1 across the band.
    pub x: f64,
    /// Sum of the real parts.
    pub re: f64,
    /// Sum of the imaginary parts.
    pub im: f64,
    /// Sum of the squared magnitudes of the coefficients.
    pub power: f64,
    /// Shape of the noise floor: 1, or more where the skirts of other modes lie.
    pub floor: f64,
}

/// Number of cells that the likelihood adds up at once. Lanes beyond the last cell hold no lines.
pub const LANES: usize = 8;

/// [`LANES`] neighbouring cells, quantity by quantity.
#[derive(Debug, Clone, Copy)]
pub struct Block {
    /// As in [`Cell`], one entry per lane.
    pub lines: [f64; LANES],
    /// Mean frequencies \[Hz\].
    pub frequency_hz: [f64; LANES],
    /// Frequencies scaled to -1 to 1 across the band.
    pub x: [f64; LANES],
    /// Sums of the real parts.
    pub re: [f64; LANES],
    /// Sums of the imaginary parts.
    pub im: [f64; LANES],
    /// Sums of the squared magnitudes.
    pub power: [f64; LANES],
    /// Shape of the noise floor.
    pub floor: [f64; LANES],
    /// True if no cell holds more than one line.
    pub is_single: bool,
}

impl Block {
    /// No lines at all, at a frequency where every response is finite.
    fn empty(frequency_hz: f64) -> Self {
        Self {
            lines: [0.0; LANES],
            frequency_hz: [frequency_hz; LANES],
            x: [0.0; LANES],
            re: [0.0; LANES],
            im: [0.0; LANES],
            power: [0.0; LANES],
            floor: [1.0; LANES],
            is_single: true,
        }
    }

    fn get(&self, lane: usize) -> Cell {
        Cell {
            lines: self.lines[lane],
            frequency_hz: self.frequency_hz[lane],
            x: self.x[lane],
            re: self.re[lane],
            im: self.im[lane],
            power: self.power[lane],
            floor: self.floor[lane],
        }
    }

    fn set(&mut self, lane: usize, cell: &Cell) {
        self.lines[lane] = cell.lines;
        self.frequency_hz[lane] = cell.frequency_hz;
        self.x[lane] = cell.x;
        self.re[lane] = cell.re;
        self.im[lane] = cell.im;
        self.power[lane] = cell.power;
        self.floor[lane] = cell.floor;
        self.is_single &= cell.lines <= 1.0;
    }
}

/// The coefficients of one record in a narrow band.
#[derive(Debug, Clone, Default)]
pub struct Band {
    /// Length of the record, T \[s\].
    pub duration_s: f64,
    /// The band's middle \[Hz\].
    pub middle_hz: f64,
    /// Half its width \[Hz\].
    pub half_width_hz: f64,
    /// Number of coefficients.
    pub lines: f64,
    /// Largest ordinate of the raw periodogram.
    pub largest: f64,
    /// Number of cells.
    cells: usize,
    blocks: Vec<Block>,
}

impl Band {
    fn push(&mut self, cell: &Cell) {
        let lane = self.cells % LANES;
        if lane == 0 {
            self.blocks.push(Block::empty(cell.frequency_hz));
        }
        if let Some(block) = self.blocks.last_mut() {
            block.set(lane, cell);
        }
        self.cells += 1;
        self.lines += cell.lines;
    }

    /// The same lines in wider cells: neighbours are added up as long as a cell stays within `width_hz` of its frequency, as
    /// [`Coefficients::band`] does.
    pub fn merged(&self, width_hz: impl Fn(f64) -> f64) -> Self {
        let mut merged = Self {
            cells: 0,
            lines: 0.0,
            blocks: Vec::new(),
            ..*self
        };
        let mut cells = self.cells().peekable();
        while let Some(first) = cells.next() {
            // A line is as wide as its distance from the next, up to rounding.
            let end_hz = first.frequency_hz + width_hz(first.frequency_hz) - (1.0 - 1e-6) / self.duration_s;
            let mut sum = first;
            let mut weighted = [first.frequency_hz, first.x, first.floor].map(|value| first.lines * value);
            while let Some(next) = cells.next_if(|next| next.frequency_hz < end_hz) {
                sum.lines += next.lines;
                sum.re += next.re;
                sum.im += next.im;
                sum.power += next.power;
                let more = [next.frequency_hz, next.x, next.floor].map(|value| next.lines * value);
                weighted = std::array::from_fn(|i| weighted[i] + more[i]);
            }
            if sum.lines > first.lines {
                [sum.frequency_hz, sum.x, sum.floor] = weighted.map(|value| value / sum.lines);
            }
            merged.push(&sum);
        }
        merged
    }

    /// True for a frequency \[Hz\] more than a hundredth of a line inside the band.
    pub fn holds(&self, hz: f64) -> bool {
        self.half_width_hz - (hz - self.middle_hz).abs() > 0.01 / self.duration_s
    }

    /// The cells side by side, in ascending frequency.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// The cells one by one, in ascending frequency.
    pub fn cells(&self) -> impl Iterator<Item = Cell> {
        (0..self.cells).map(|i| self.blocks[i / LANES].get(i % LANES))
    }

    /// Changes the content of every cell, not its number of lines.
    pub fn for_each(&mut self, mut change: impl FnMut(&mut Cell)) {
        for i in 0..self.cells {
            let block = &mut self.blocks[i / LANES];
            let mut cell = block.get(i % LANES);
            change(&mut cell);
            block.set(i % LANES, &cell);
        }
    }

    /// Noise floor estimated from the quietest fifth of the cells: the lower quintile of an exponential
    /// distribution is 0.223 of its mean (a cell of several lines scatters less).
    pub fn quiet_level(&self) -> f64 {
        let mut powers: Vec<f64> = self.cells().map(|c| c.power / c.lines).collect();
        let fifth = powers.len() / 5;
        if powers.is_empty() {
            return f64::MIN_POSITIVE;
        }
        let (_, value, _) = powers.select_nth_unstable_by(fifth, f64::total_cmp);
        (*value / 0.223).max(f64::MIN_POSITIVE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wider_cells_hold_the_same_lines() {
        let lines = (0..400).map(|i| Complex::new(f64::from(i).sin(), f64::from(i * i).cos()));
        let coefficients = Coefficients {
            duration_s: 20.0,
            lines: lines.collect(),
        };
        let fine = coefficients.band(2.0, 18.0, &[], |_| 0.0);
        // Three lines a cell, from 10 Hz on.
        let wide = |f: f64| if f < 9.99 { 0.0 } else { 0.199 };
        let merged = fine.merged(wide);
        let direct = coefficients.band(2.0, 18.0, &[], wide);
        assert_eq!(merged.cells().count(), 160 + 54);
        assert_eq!((merged.lines, merged.largest), (fine.lines, fine.largest));
        assert_eq!(coefficients.count(2.0, 18.0, &[]) as f64, fine.lines);
        let masks = [Mask {
            low_hz: 5.0,
            high_hz: 9.0,
        }];
        let masked = coefficients.band(2.0, 18.0, &masks, wide);
        assert_eq!(coefficients.count(2.0, 18.0, &masks) as f64, masked.lines);
        for (a, b) in merged.cells().zip(direct.cells()) {
            assert_eq!((a.lines, a.re, a.power), (b.lines, b.re, b.power));
        }
        let sum = |band: &Band, of: fn(Cell) -> f64| band.cells().map(of).sum::<f64>();
        let sums: [fn(Cell) -> f64; 5] = [
            |c| c.re,
            |c| c.im,
            |c| c.power,
            |c| c.lines * c.x,
            |c| c.lines * c.frequency_hz,
        ];
        for of in sums {
            // Rounding of a sum of 321 terms.
            assert!((sum(&merged, of) - sum(&fine, of)).abs() < 1e-9);
        }
        assert!(merged.cells().all(|cell| cell.floor == 1.0));
    }
}
