//! Two two-sided CUSUM charts, one for steps and one for slow ramps, that share one false-alarm budget.

use serde::{Deserialize, Serialize};

/// Residuals beyond this count as this: one wild period alone never raises an alarm.
pub const CLAMP: f64 = 5.0;

/// One chart's constants.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Chart {
    /// Reference value, in standard deviations.
    pub k: f64,
    /// Decision limit, in standard deviations.
    pub h: f64,
}

/// Both charts with the false-alarm rate they keep together.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Design {
    /// For steps, for ramps.
    pub charts: [Chart; 2],
    /// Mean number of periods between false alarms of both charts, both sides.
    pub arl0_periods: f64,
}

impl Design {
    /// The limits h for reference values `k` that give both charts together the wanted mean run length
    /// (periods), half of the alarms each.
    pub fn new(_k: [f64; 2], _arl0_periods: f64) -> Self {
        todo!()
    }
}

/// Which side of a chart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Side {
    /// More force.
    Up,
    /// Less force.
    Down,
}

/// An alarm of a chart.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Signal {
    /// Which chart: 0 for steps, 1 for ramps.
    pub chart: usize,
    /// Which side.
    pub side: Side,
    /// The first period since the side last stood at zero.
    pub since: i64,
}

/// The running statistics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Charts {
    design: Design,
    /// \[chart\]\[0 up, 1 down\].
    statistic: [[f64; 2]; 2],
    /// First period since the side last stood at zero.
    since: [[Option<i64>; 2]; 2],
}

impl Charts {
    /// All at zero.
    pub fn new(design: Design) -> Self {
        Self {
            design,
            statistic: [[0.0; 2]; 2],
            since: [[None; 2]; 2],
        }
    }

    /// Takes the residual of a period; the signal with the largest excess if any side is above its limit.
    pub fn update(&mut self, _period: i64, _residual: f64) -> Option<Signal> {
        todo!()
    }

    /// The statistics: \[chart\]\[0 up, 1 down\].
    pub fn statistic(&self) -> [[f64; 2]; 2] {
        self.statistic
    }

    /// Back to zero.
    pub fn reset(&mut self) {
        *self = Self::new(self.design);
    }

    /// Whether every side is below half its limit: what raised an alarm is over.
    pub fn is_calm(&self) -> bool {
        todo!()
    }

    /// The constants.
    pub fn design(&self) -> &Design {
        &self.design
    }
}
