//! Chooses the orders to report, or the reason why none are.

use super::super::{Candidate, Labels, Mode, ModeSettings, MotionKind, Resonance};
use super::code::Code;
use super::evidence::Scene;
use super::force::axial_force_n;
use super::peak::{Peak, peaks};
use super::posterior::Posterior;
use super::rod::Rod;
use super::search::Grid;
use crate::rod::beam::forward::MAX_MODES;
use crate::rod::prior::RodPrior;
use crate::signal::record::Rejection;

/// Largest probability allowed that a reported peak has another order: worse than a foreign peak beside right
/// ones, since the force is then entirely wrong.
const MOST_WRONG_ORDER: f64 = 0.04;
/// Probability that the rest must reach; until then orders that the force does not use are left out.
const SURE: f64 = 0.995;
/// Largest probability allowed that no rod is seen: where the force is hardly known beforehand, and where it
/// is known.
const MOST_NO_ROD: f64 = 0.006;
const MOST_NO_ROD_KNOWN: f64 = 0.0004;
/// A rod whose first mode is known beforehand to this standard deviation of ln f counts as known, for
/// instance by a force stated to 30 % where section and material are known.
const KNOWN_LOG_SD: f64 = 0.21;
/// The same where a person declares that the first mode is among the peaks.
const MOST_NO_ROD_DECLARED: f64 = 0.5;
/// Log odds of there being no rod in a struck record, in addition to those of any record: a person who
/// strikes, strikes the rod. Not per peak, since a decay is recognised in 1.3 % of records where nothing is
/// struck. That allows no more than the second, which holds where the promise is one wrong record in a
/// thousand.
const STRUCK: f64 = -8.0;
const STRUCK_KNOWN: f64 = -4.9;
/// Largest share of the assignments of several peaks by which the mode declared to be the first may be a higher one.
const MOST_HIGHER: f64 = 0.9;
/// Most candidates reported, and the least probability of one after the first.
const CANDIDATES: usize = 5;
const LEAST_CANDIDATE: f64 = 0.01;
/// Factor beyond the range of the prior within which peaks are still considered.
const WIDER: f64 = 1.15;

/// Prior and settings from which the labels of one rod's records are inferred; made once per rod.
#[derive(Debug, Clone)]
pub struct LabelPlan {
    rod: Rod,
    grid: Grid,
    discrepancy: Vec<f64>,
    settings: ModeSettings,
    is_known: bool,
}

/// The labelled modes of a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Labelling {
    /// Every mode reported, ascending in order; also those above the orders that the force uses.
    pub modes: Vec<Mode>,
    /// Probability of each mode, in the same order.
    pub probability: Vec<f64>,
    /// Their joint probability, and the candidates.
    pub labels: Labels,
}

/// Peaks without credible orders.
#[derive(Debug, Clone, PartialEq)]
pub struct Unlabelled {
    /// Reason, with advice on what would decide between the candidates.
    pub rejection: Rejection,
    /// Candidate assignments of the peaks.
    pub labels: Labels,
}

impl LabelPlan {
    /// A plan from the rod's prior, the model's relative discrepancy per order (beyond its end the last
    /// entry; never below 1 %) and the settings. `None` if the prior holds no tensioned rod.
    pub fn new(prior: &RodPrior, discrepancy: &[f64], settings: ModeSettings) -> Option<Self> {
        let rod = Rod::new(prior)?;
        let grid = Grid::new(&rod);
        // In the string limit; less with bending.
        let force_sd = 0.25 * (rod.force.at(1.0).0 - rod.force.at(-1.0).0);
        let is_known = (rod.level.1 * rod.level.1 + force_sd * force_sd).sqrt() < KNOWN_LOG_SD;
        Some(Self {
            rod,
            grid,
            discrepancy: discrepancy.to_vec(),
            settings,
            is_known,
        })
    }

    /// Modes searched for, and where.
    pub fn settings(&self) -> &ModeSettings {
        &self.settings
    }

    /// Band searched for the rod's peaks \[Hz\]: as configured, else all orders of all rods that the prior
    /// holds; and the windows of modes assigned by hand.
    pub fn band_hz(&self) -> (f64, f64) {
        let ((low, high), _) = self.grid.range();
        let band = self.settings.band_hz.map_or(
            (libm::exp(low) / WIDER, libm::exp(high) * WIDER),
            |[low_hz, high_hz]| (low_hz, high_hz),
        );
        let windows = self.settings.windows.iter();
        windows.fold(band, |(low_hz, high_hz), window| {
            (low_hz.min(window.low_hz), high_hz.max(window.high_hz))
        })
    }

    /// Highest frequency expected of the first mode \[Hz\].
    pub fn first_mode_below_hz(&self) -> f64 {
        libm::exp(self.grid.range().1)
    }

    /// Labels the resonances (ascending in frequency) of a record that was searched between the frequencies
    /// `seen_hz`, with a motion of `kind`.
    ///
    /// # Errors
    /// No assignment is probable enough.
    pub fn label(
        &self,
        resonances: &[Resonance],
        seen_hz: (f64, f64),
        kind: MotionKind,
    ) -> Result<Labelling, Unlabelled> {
        let (low_hz, high_hz) = self.band_hz();
        let low_hz = low_hz.max(seen_hz.0);
        let high_hz = high_hz.min(seen_hz.1).max(1.001 * low_hz);
        let masks = &self.settings.masks;
        let is_masked = |hz: f64| masks.iter().any(|mask| mask.contains(hz));
        let is_searched = |hz: f64| (low_hz..=high_hz).contains(&hz) && !is_masked(hz);
        let log_band = libm::log(high_hz / low_hz).max(0.1);
        let is_struck = matches!(kind, MotionKind::FreeDecay | MotionKind::FreeDecays);
        let peaks = peaks(resonances, is_searched, log_band, is_struck);
        let log_masks: Vec<(f64, f64)> = masks
            .iter()
            .map(|mask| (libm::log(mask.low_hz), libm::log(mask.high_hz)))
            .collect();
        let declared = self.declared(&peaks, resonances);
        let windows = self.settings.windows.iter();
        let absent = windows
            .filter(|window| declared.peak_of(window.order).is_none())
            .fold(0, |orders, window| orders | 1 << (window.order - 1));
        let scene = Scene {
            rod: &self.rod,
            peaks: &peaks,
            discrepancy: &self.discrepancy,
            band: (libm::log(low_hz), libm::log(high_hz)),
            masks: &log_masks,
            declared,
            absent,
            log_struck: match (is_struck, self.is_known) {
                (false, _) => 0.0,
                (true, false) => STRUCK,
                (true, true) => STRUCK_KNOWN,
            },
            is_first_seen: self.settings.count == 1,
        };
        let told = Told {
            plan: self,
            scene: &scene,
            resonances,
            posterior: Posterior::of(&scene, &self.grid),
        };
        told.contradiction(&self.grid).map_or_else(|| told.choose(), Err)
    }

    /// Assignment of the clearest peak in each declared window.
    fn declared(&self, peaks: &[Peak], resonances: &[Resonance]) -> Code {
        let mut declared = Code::default();
        for window in &self.settings.windows {
            let evidence = |i: &usize| resonances[peaks[*i].resonance].evidence;
            let inside = (0..peaks.len()).filter(|&i| {
                let hz = resonances[peaks[i].resonance].frequency_hz;
                (window.low_hz..=window.high_hz).contains(&hz)
            });
            let best = inside.max_by(|a, b| evidence(a).total_cmp(&evidence(b)));
            declared = declared.with(window.order, best);
        }
        declared
    }
}

/// Working data of one record's labelling.
struct Told<'a> {
    plan: &'a LabelPlan,
    scene: &'a Scene<'a>,
    resonances: &'a [Resonance],
    posterior: Posterior,
}

impl Told<'_> {
    /// Refusal where the other peaks say that the one declared to be the first mode is a higher one.
    fn contradiction(&self, grid: &Grid) -> Option<Unlabelled> {
        let best = self.posterior.fits.first()?.code;
        let peak = best.peak_of(1).filter(|_| self.scene.is_first_seen)?;
        let scene = Scene {
            is_first_seen: false,
            ..*self.scene
        };
        let undeclared = Posterior::of(&scene, grid);
        let of_order = |is_it: fn(usize) -> bool| {
            undeclared
                .probability(|code| code.order_of(peak).is_some_and(is_it) && code.pairs().nth(1).is_some())
        };
        let (first, higher) = (of_order(|order| order == 1), of_order(|order| order > 1));
        (higher > MOST_HIGHER * (first + higher) && higher > undeclared.no_rod).then(|| {
            let told = Told {
                scene: &scene,
                posterior: undeclared,
                ..*self
            };
            let reason = format!(
                "modes.count = 1 declares that {:.4} Hz is the first mode, which the other peaks contradict; {}; leave modes.count out",
                self.hz(peak),
                told.rivals()
            );
            told.refused(Code::default(), reason)
        })
    }

    fn choose(&self) -> Result<Labelling, Unlabelled> {
        let posterior = &self.posterior;
        let settings = &self.plan.settings;
        let Some(best) = posterior.fits.first() else {
            let reason =
                "no order of a rod of this prior fits any of them: correct [rod.priors], or narrow band_hz";
            return Err(self.refused(Code::default(), reason.to_owned()));
        };
        let most_no_rod = match () {
            () if self.scene.is_first_seen => MOST_NO_ROD_DECLARED,
            () if self.plan.is_known => MOST_NO_ROD_KNOWN,
            () => MOST_NO_ROD,
        };
        if posterior.no_rod > most_no_rod {
            let reason = format!(
                "with probability {:.4} none of them is the rod's, at most {most_no_rod} is allowed; {}",
                posterior.no_rod,
                self.deciding(best.code)
            );
            return Err(self.refused(Code::default(), reason));
        }
        let certain = self.certain(best.code);
        let told = self.used(certain);
        let is_declared = self.scene.is_first_seen
            || told
                .pairs()
                .any(|(order, _)| self.scene.declared.peak_of(order).is_some());
        let mut pairs = certain.pairs();
        if let (Some((order, peak)), None, false) = (pairs.next(), pairs.next(), is_declared) {
            let reason = format!(
                "only {:.4} Hz is certain, as mode {order}, and one peak alone proves nothing; {}",
                self.hz(peak),
                self.deciding(best.code)
            );
            return Err(self.refused(told, reason));
        }
        if told.pairs().all(|(order, _)| order > settings.count) {
            let certain = told
                .pairs()
                .map(|(order, peak)| format!("{:.4} Hz is mode {order}", self.hz(peak)))
                .collect::<Vec<_>>();
            let reason = if certain.is_empty() {
                format!("{}; {}", self.rivals(), self.deciding(best.code))
            } else {
                let highest = told.pairs().filter(|(order, _)| *order <= MAX_MODES).last();
                let remedy = highest.map_or(String::new(), |(order, _)| {
                    format!("; modes.count = {order} would use it")
                });
                format!(
                    "{}, but no mode up to modes.count = {}{remedy}",
                    certain.join(", "),
                    settings.count
                )
            };
            return Err(self.refused(told, reason));
        }
        let (modes, probability) = told
            .pairs()
            .map(|(order, peak)| {
                let resonance = &self.resonances[self.scene.peaks[peak].resonance];
                let mode = Mode {
                    order,
                    frequency_hz: resonance.frequency_hz,
                    sd_hz: resonance.frequency_sd_hz,
                    damping: Some(resonance.damping),
                };
                (
                    mode,
                    self.posterior
                        .probability(|code| code.peak_of(order) == Some(peak)),
                )
            })
            .unzip();
        Ok(Labelling {
            modes,
            probability,
            labels: self.labels(told),
        })
    }

    /// Part of an assignment that is probable enough: without its least certain pairs until the rest reaches the required level.
    fn certain(&self, best: Code) -> Code {
        let wrong = |told: Code| self.posterior.probability(|code| code.contradicts(told));
        let mut told = best;
        while self.right(told) < self.plan.settings.least_probability || wrong(told) > MOST_WRONG_ORDER {
            let Some(order) = self.least_certain(told, 1) else {
                return self.scene.declared;
            };
            told = told.with(order, None);
        }
        told
    }

    /// Part of a certain assignment: without pairs that the force does not use until the rest is sure.
    fn used(&self, certain: Code) -> Code {
        let mut told = certain;
        while self.right(told) < SURE
            && let Some(order) = self.least_certain(told, self.plan.settings.count + 1)
        {
            told = told.with(order, None);
        }
        told
    }

    fn right(&self, told: Code) -> f64 {
        self.posterior.probability(|code| code.contains(told))
    }

    /// Order of the least certain pair from an order on; peaks declared by a person stay in any case.
    fn least_certain(&self, told: Code, from: usize) -> Option<usize> {
        let free = told
            .pairs()
            .filter(|&(order, _)| order >= from && self.scene.declared.peak_of(order).is_none());
        let of_pair = |(order, peak)| {
            let probability = self
                .posterior
                .probability(|code| code.peak_of(order) == Some(peak));
            (order, probability)
        };
        let least = free.map(of_pair).min_by(|a, b| a.1.total_cmp(&b.1));
        least.map(|(order, _)| order)
    }

    fn hz(&self, peak: usize) -> f64 {
        self.resonances[self.scene.peaks[peak].resonance].frequency_hz
    }

    fn refused(&self, told: Code, detail: String) -> Unlabelled {
        let labels = self.labels(told);
        Unlabelled {
            rejection: Rejection::NoLabel {
                peaks: self.resonances.len(),
                detail,
            },
            labels,
        }
    }

    fn labels(&self, told: Code) -> Labels {
        let fits = self.posterior.fits.iter().zip(&self.posterior.probabilities);
        let candidates = fits
            .take(CANDIDATES)
            .enumerate()
            .filter(|(i, (_, probability))| *i == 0 || **probability >= LEAST_CANDIDATE)
            .map(|(_, (fit, &probability))| Candidate {
                modes: fit
                    .code
                    .pairs()
                    .map(|(order, peak)| (order, self.hz(peak)))
                    .collect(),
                probability,
                axial_force_n: axial_force_n(self.scene, fit),
            })
            .collect();
        let probability = if told == Code::default() {
            0.0
        } else {
            self.posterior.probability(|code| code.contains(told))
        };
        Labels {
            probability,
            told: told.pairs().map(|(order, peak)| (order, self.hz(peak))).collect(),
            candidates,
        }
    }

    /// The two likeliest assignments in words; forces with three digits.
    fn rivals(&self) -> String {
        let fits = self.posterior.fits.iter().zip(&self.posterior.probabilities);
        let kilo = |newtons: f64| {
            let (kn, digits) = (
                1e-3 * newtons,
                2.0 - (1e-3 * newtons).abs().max(1e-3).log10().floor(),
            );
            format!("{kn:.*}", digits.max(0.0) as usize)
        };
        let one = |(fit, probability): (&super::evidence::Fit, &f64)| {
            let modes: Vec<String> = fit
                .code
                .pairs()
                .map(|(order, peak)| format!("{order} at {:.2}", self.hz(peak)))
                .collect();
            let force = axial_force_n(self.scene, fit).map_or(String::new(), |[low, _, high]| {
                format!(", {} to {} kN", kilo(low), kilo(high))
            });
            format!("{} Hz ({:.0} %{force})", modes.join(", "), 100.0 * probability)
        };
        let told: Vec<String> = fits.take(2).map(one).collect();
        format!("the likeliest are {}", told.join(" or "))
    }

    /// Advice for a person on how to decide between the candidates.
    fn deciding(&self, best: Code) -> String {
        let posterior = &self.posterior;
        let shifted = posterior.probability(|code| code.contradicts(best));
        let foreign: Vec<String> = (0..self.scene.peaks.len())
            .filter(|&peak| best.order_of(peak).is_none())
            .map(|peak| format!("{:.2} Hz", self.hz(peak)))
            .collect();
        let mut remedies = Vec::new();
        if shifted > MOST_WRONG_ORDER {
            remedies.push("a narrower prior of axial_force_n".to_owned());
        }
        if !foreign.is_empty() {
            remedies.push(format!(
                "a mask over what is not the rod's, if it is among {}",
                foreign.join(", ")
            ));
        }
        if self.scene.peaks.len() < 3 {
            remedies.push("a record in which more modes stand out".to_owned());
        }
        let mut pairs = best.pairs();
        if let (Some((1, peak)), None) = (pairs.next(), pairs.next()) {
            remedies.push(format!(
                "modes.count = 1, if {:.2} Hz is known to be the first mode",
                self.hz(peak)
            ));
        }
        remedies.push("a window per mode in [rod.modes]".to_owned());
        format!("what would decide: {}", remedies.join(", or "))
    }
}
