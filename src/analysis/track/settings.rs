//! Settings of tracking and alarms.

use serde::Serialize;

/// Settings of tracking the relative force (`[track]`).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrackSettings {
    /// Number of accepted records that make up the baseline.
    pub baseline_records: usize,
    /// Number of periods used only to learn the effect of temperature, the baseline's included.
    pub learning_periods: usize,
    /// Length of a period \[s\]: statistics further apart are taken as independent but for the modelled
    /// autocorrelation.
    pub period_s: f64,
    /// Largest delay of a record that still counts in its period \[s\].
    pub reorder_window_s: f64,
    /// Least relative model discrepancy per mode in the baseline's generative model \[-\].
    pub discrepancy: f64,
    /// Number of particles of the static parameters.
    pub particles: usize,
    /// Use of the temperature.
    pub temperature: TemperatureUse,
    /// Temperature to which force is referred \[degC\]; `None`: the baseline's mean.
    pub reference_temperature_c: Option<f64>,
    /// Thermal expansion of the rod \[1/K\].
    pub expansion_per_k: f64,
}

/// Use of the temperature.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum TemperatureUse {
    /// The force is compensated; without a temperature nothing is charted, and every output is marked so.
    Compensate,
    /// The force is charted uncompensated: a rod that is free to expand, or a room of constant temperature.
    Ignore,
}

/// Settings of the alarms (`[alarm]`).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AlarmSettings {
    /// Mean time between false drift alarms per rod \[years\].
    pub arl0_years: f64,
    /// True if the site's rods are compared with each other.
    pub compare_rods: bool,
    /// Relative loss of force at the reference temperature that must not be exceeded \[-\].
    pub limit_loss: f64,
    /// Probability from which the limit counts as exceeded \[-\].
    pub limit_probability: f64,
    /// Probability of a period's misfit, under a change of axial force alone, below which it is not axial \[-\].
    pub not_axial_p: f64,
    /// Conflict of a record with the model from which it is reported, in standard deviations.
    pub conflict_sd: f64,
    /// Number of periods or records in a row that raise or clear a condition.
    pub confirm: usize,
    /// Number of rejected or implausible records in a row that mean the sensor needs attention.
    pub sensor_records: usize,
    /// Silence that raises an alarm \[s\].
    pub silence_s: f64,
    /// Time after which an unacknowledged alarm is repeated \[s\].
    pub repeat_s: f64,
}

impl Default for TrackSettings {
    fn default() -> Self {
        Self {
            baseline_records: 30,
            learning_periods: 30,
            period_s: 86_400.0,
            reorder_window_s: 3600.0,
            discrepancy: 0.01,
            particles: 512,
            temperature: TemperatureUse::Compensate,
            reference_temperature_c: None,
            expansion_per_k: 1.2e-5,
        }
    }
}

impl Default for AlarmSettings {
    fn default() -> Self {
        Self {
            arl0_years: 10.0,
            compare_rods: true,
            limit_loss: 0.05,
            limit_probability: 0.95,
            not_axial_p: 0.001,
            conflict_sd: 4.0,
            confirm: 3,
            sensor_records: 5,
            silence_s: 3.0 * 86_400.0,
            repeat_s: 7.0 * 86_400.0,
        }
    }
}
