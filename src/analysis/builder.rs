//! A rod described quantity by quantity, and made ready for records.

use crate::identify::{AnalysisSettings, Plan};
use crate::inference::{AbcSettings, PlanError, Tables};
use crate::rod::beam::{Parameterisation, Quantity, Section};
use crate::rod::emulator::{ModelSettings, ReducedModel};
use crate::rod::prior::{Prior, RodPrior};
use crate::signal::modes::ModeSettings;
use crate::signal::record::RodId;
use crate::signal::spectrum::{PeakSettings, WelchSettings};
use std::sync::Arc;
use thiserror::Error;

/// Relative model discrepancy of a rod of which nothing else is said \[-\].
const DISCREPANCY: f64 = 0.01;

/// A rod under description: its section, and what is known of each quantity beforehand.
///
/// Every quantity of the section must be given, as a number (known exactly) or as a [`Prior`]; SI throughout.
/// [`Rod::prepare`] makes the [`Plan`] that takes records and frequencies.
#[derive(Debug, Clone)]
#[must_use]
pub struct Rod {
    id: RodId,
    section: Section,
    priors: Vec<(Quantity, Prior)>,
    discrepancy: f64,
    modes: ModeSettings,
    abc: AbcSettings,
    seed: u64,
}

/// Description that makes no rod.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RodError {
    /// Quantities of the section are not given.
    #[error("not given: {}", .0.join(", "))]
    Missing(Vec<&'static str>),
    /// A quantity that the section does not have.
    #[error("{quantity} is no quantity of a {section} section")]
    Foreign {
        /// Key of the quantity.
        quantity: &'static str,
        /// Name of the section.
        section: &'static str,
    },
    /// Priors or settings that contradict each other.
    #[error(transparent)]
    Plan(#[from] PlanError),
}

impl Rod {
    /// A rod of square section: give its [side](Self::side_m).
    pub fn square(id: &str) -> Self {
        Self::of(id, Section::Square)
    }

    /// A round rod: give its [diameter](Self::diameter_m).
    pub fn round(id: &str) -> Self {
        Self::of(id, Section::Round)
    }

    /// A rod of rectangular section: give [width](Self::width_m) and [height](Self::height_m).
    pub fn rectangle(id: &str) -> Self {
        Self::of(id, Section::Rectangle)
    }

    /// A rod given by [flexural rigidity](Self::flexural_rigidity_n_m2) and
    /// [mass per length](Self::mass_per_length_kg_m).
    pub fn direct(id: &str) -> Self {
        Self::of(id, Section::Direct)
    }

    fn of(id: &str, section: Section) -> Self {
        Self {
            id: RodId(id.to_owned()),
            section,
            priors: Vec::new(),
            discrepancy: DISCREPANCY,
            modes: ModeSettings::default(),
            abc: AbcSettings::default(),
            seed: 1,
        }
    }

    /// One quantity, in SI; the last of several counts.
    pub fn with(mut self, quantity: Quantity, prior: impl Into<Prior>) -> Self {
        self.priors.retain(|(known, _)| *known != quantity);
        self.priors.push((quantity, prior.into()));
        self
    }

    /// Free length between the supports \[m\].
    pub fn length_m(self, prior: impl Into<Prior>) -> Self {
        self.with(Quantity::Length, prior)
    }

    /// Side of a square section \[m\].
    pub fn side_m(self, prior: impl Into<Prior>) -> Self {
        self.with(Quantity::Side, prior)
    }

    /// Diameter of a round section \[m\].
    pub fn diameter_m(self, prior: impl Into<Prior>) -> Self {
        self.with(Quantity::Diameter, prior)
    }

    /// Width of a rectangle, across the plane of vibration \[m\].
    pub fn width_m(self, prior: impl Into<Prior>) -> Self {
        self.with(Quantity::Width, prior)
    }

    /// Height of a rectangle, in the plane of vibration \[m\].
    pub fn height_m(self, prior: impl Into<Prior>) -> Self {
        self.with(Quantity::Height, prior)
    }

    /// Flexural rigidity EI \[N m^2\].
    pub fn flexural_rigidity_n_m2(self, prior: impl Into<Prior>) -> Self {
        self.with(Quantity::FlexuralRigidity, prior)
    }

    /// Mass per length \[kg/m\].
    pub fn mass_per_length_kg_m(self, prior: impl Into<Prior>) -> Self {
        self.with(Quantity::MassPerLength, prior)
    }

    /// Axial force, tension positive \[N\].
    pub fn axial_force_n(self, prior: impl Into<Prior>) -> Self {
        self.with(Quantity::AxialForce, prior)
    }

    /// Young's modulus \[Pa\].
    pub fn youngs_modulus_pa(self, prior: impl Into<Prior>) -> Self {
        self.with(Quantity::YoungsModulus, prior)
    }

    /// Mass density \[kg/m^3\].
    pub fn density_kg_m3(self, prior: impl Into<Prior>) -> Self {
        self.with(Quantity::Density, prior)
    }

    /// Rotational stiffness of both supports, independent of each other \[N m/rad\]; zero is a hinge.
    pub fn springs_n_m(self, prior: impl Into<Prior>) -> Self {
        let prior = prior.into();
        self.with(Quantity::SpringLeft, prior)
            .with(Quantity::SpringRight, prior)
    }

    /// Relative discrepancy of the model, the same for every mode (standard deviation of b / y) \[-\]; 0.01 unless
    /// said, 0 in the paper.
    pub fn discrepancy(self, discrepancy: f64) -> Self {
        Self { discrepancy, ..self }
    }

    /// Modes searched for in records, and where; the first three unless said.
    pub fn modes(self, modes: ModeSettings) -> Self {
        Self { modes, ..self }
    }

    /// Settings of the approximate Bayesian computation.
    pub fn abc(self, abc: AbcSettings) -> Self {
        Self { abc, ..self }
    }

    /// Seed of all random numbers; 1 unless said. The same seed gives the same bits.
    pub fn seed(self, seed: u64) -> Self {
        Self { seed, ..self }
    }

    /// Settings of the rod's analysis.
    ///
    /// # Errors
    /// A quantity is missing, or does not belong to the section.
    pub fn settings(self) -> Result<AnalysisSettings, RodError> {
        let quantities = self.section.quantities();
        if let Some((foreign, _)) = self.priors.iter().find(|(q, _)| !quantities.contains(q)) {
            return Err(RodError::Foreign {
                quantity: foreign.key(),
                section: self.section.key(),
            });
        }
        let mut priors = Vec::with_capacity(quantities.len());
        let mut missing = Vec::new();
        for quantity in quantities {
            match self.priors.iter().find(|(known, _)| known == quantity) {
                Some((_, prior)) => priors.push(*prior),
                None => missing.push(quantity.key()),
            }
        }
        // One prior for each quantity, unless some are missing.
        let Some(prior) = RodPrior::new(Parameterisation::new(self.section), priors) else {
            return Err(RodError::Missing(missing));
        };
        Ok(AnalysisSettings {
            rod: self.id,
            prior,
            discrepancy: vec![self.discrepancy; self.modes.count],
            welch: WelchSettings::default(),
            peaks: PeakSettings::default(),
            modes: self.modes,
            tests: Vec::new(),
            sensors: Vec::new(),
            abc: self.abc,
            model: ModelSettings::Reduced,
            seed: self.seed,
        })
    }

    /// The rod ready for records and frequencies; its frequencies are those of the reduced emulator.
    ///
    /// # Errors
    /// As of [`Rod::settings`], and priors or settings that contradict each other.
    pub fn prepare(self) -> Result<Plan, RodError> {
        let tables = Tables::new(self.seed);
        let settings = self.settings()?;
        let model = ReducedModel::new(*settings.prior.parameterisation());
        Ok(Plan::new(settings, Arc::new(model), &tables)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_description_is_complete_or_names_what_is_missing() {
        let hinged = Rod::round("a").springs_n_m(0.0).length_m(9.5);
        let missing = hinged.clone().settings().unwrap_err();
        let keys = [
            "axial_force_n",
            "youngs_modulus_pa",
            "density_kg_m3",
            "diameter_m",
        ];
        assert_eq!(missing, RodError::Missing(keys.to_vec()));
        let foreign = hinged.clone().side_m(0.04).settings().unwrap_err();
        assert_eq!(foreign.to_string(), "side_m is no quantity of a round section");
        let rod = hinged.diameter_m(0.05).diameter_m(0.045).density_kg_m3(7650.0);
        let rod = rod.youngs_modulus_pa(190e9).axial_force_n(60e3);
        let settings = rod.clone().settings().unwrap();
        assert_eq!(settings.prior.of(Quantity::Diameter), Some(&Prior::from(0.045)));
        // Nothing is left to infer.
        assert_eq!(
            rod.prepare().err(),
            Some(RodError::Plan(PlanError::NothingUncertain))
        );
    }

    #[test]
    fn the_papers_rod_is_that_of_the_configuration() {
        let rod = Rod::square("todi")
            .axial_force_n(Prior::normal(800e3, 0.20))
            .youngs_modulus_pa(Prior::normal(2.0e11, 0.30))
            .density_kg_m3(Prior::normal(7500.0, 0.10))
            .side_m(Prior::normal(0.07, 0.10))
            .springs_n_m(Prior::normal(400e3, 0.30))
            .length_m(14.0);
        assert_eq!(rod.settings().unwrap().prior, RodPrior::todi());
    }
}
