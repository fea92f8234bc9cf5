//! Losses so large that nothing else explains them: reported from single records, in every state of the
//! tracker.
//!
//! With f^2 = a (N + b), b >= 0 for every mode of a beam under tension, a fall of a natural frequency bounds the force that is
//! left: N_t / N_0 <= (f_t / f_0)^2. That needs neither temperature nor training.

use super::tracker::Tracker;
use super::verdict::AtReference;
use crate::track::baseline::Baseline;
use crate::track::observation::Observation;
use crate::track::relative::Relative;

/// A loss is sudden and certain if it exceeds the limit by this factor, or by this much.
const TIMES_LIMIT: f64 = 2.0;
const BEYOND_LIMIT: f64 = 0.1;

/// Least distance of a certain loss from the limit, in standard deviations.
const CERTAIN_SD: f64 = 4.0;

/// Lower bound of the loss of force that a record shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Loss {
    /// Relative loss \[-\].
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
}

impl Loss {
    /// True if it certainly exceeds a limit.
    pub fn exceeds(self, limit: f64) -> bool {
        self.mean > (TIMES_LIMIT * limit).min(limit + BEYOND_LIMIT)
            && self.mean - CERTAIN_SD * self.sd > limit
    }

    /// Loss at the reference temperature; without one, against the rod's earlier behaviour.
    pub fn of(
        tracker: &Tracker,
        observation: &Observation,
        relative: &Relative,
        at_reference: Option<&AtReference>,
    ) -> Option<Self> {
        if let Some(at_reference) = at_reference {
            return Some(Self {
                mean: 1.0 - at_reference.ratio.mean,
                sd: at_reference.ratio.sd,
            });
        }
        let ratio = relative.ratio.mean - 1.0;
        let law = tracker
            .state
            .watch
            .get()?
            .blind_law(observation.start.days(), ratio, relative.ratio.sd)?;
        Some(Self {
            mean: law.mean - ratio,
            sd: law.sd,
        })
    }

    /// Loss of a record beyond the prepared range, from the mode that fell least; `None` unless all fell.
    pub fn bound(baseline: &Baseline, observation: &Observation) -> Option<Self> {
        let falls = baseline.modes.iter().filter_map(|known| {
            let mode = observation.mode(known.order)?;
            Some((
                mode.log_frequency - known.log_frequency,
                mode.log_sd.hypot(known.log_sd),
            ))
        });
        let (least, log_sd) = falls.max_by(|a, b| a.0.total_cmp(&b.0))?;
        (least < 0.0).then(|| Self {
            mean: -libm::expm1(2.0 * least),
            sd: 2.0 * log_sd,
        })
    }
}
