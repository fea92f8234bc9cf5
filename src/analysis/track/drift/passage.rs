//! Passage of time from one period to the next: how far fluctuations decay.

use super::prior::{BankPrior, Fluctuation};
use super::spells;

/// Decay of a member's fluctuations from one period to the next.
#[derive(Debug, Clone, Copy)]
pub(super) struct Decay {
    pub fast: f64,
    pub slow: f64,
    /// Variances that the fluctuations gain, in noise variances.
    pub added: f64,
    pub slow_added: f64,
}

/// Passage of time to a period, for every member of the prior.
#[derive(Debug, Clone)]
pub(super) struct Passage {
    pub day: f64,
    /// Probability that a spell of larger noise goes on.
    pub spell_goes_on: f64,
    decays: Vec<Decay>,
}

impl Passage {
    /// Passage from the last period, if any, to `day`; an earlier day counts as the last.
    pub fn new(prior: &BankPrior, last: Option<f64>, day: f64) -> Self {
        let gap = last.map_or(0.0, |last| (day - last).max(0.0));
        // Members share a few memories.
        let mut fades: Vec<(f64, f64, f64)> = Vec::new();
        let mut fade = |memory_d: f64| {
            let known = fades.iter().copied().find(|known| known.0 == memory_d);
            known.unwrap_or_else(|| {
                let fade = (
                    memory_d,
                    libm::exp(-gap / memory_d),
                    libm::expm1(-2.0 * gap / memory_d),
                );
                fades.push(fade);
                fade
            })
        };
        let decay = |fluctuation: &Fluctuation| {
            let (_, fast, grows) = fade(fluctuation.memory_d);
            let slow = fade(fluctuation.slow_memory_d).1;
            Decay {
                fast,
                slow,
                added: -fluctuation.variance * grows,
                slow_added: fluctuation.slow_variance * (1.0 - slow * slow),
            }
        };
        Self {
            day: last.map_or(day, |last| last.max(day)),
            spell_goes_on: spells::goes_on(gap),
            decays: prior.members.iter().map(decay).collect(),
        }
    }

    /// Decay of the member with an index among the prior's.
    pub fn of(&self, which: u8) -> &Decay {
        &self.decays[usize::from(which)]
    }
}
