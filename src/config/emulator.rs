//! `[emulator]`: forward model of the natural frequencies.

use super::RodConfig;
use super::reader::{Table, key};
use crate::analysis::rod::emulator::ModelSettings;
use crate::analysis::rod::emulator::pce::{MAX_ORDER, MAX_POINTS};

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Reduced,
    Exact,
    FiniteElements,
    Pce,
}

const KINDS: [(&str, Kind); 4] = [
    ("reduced", Kind::Reduced),
    ("exact", Kind::Exact),
    ("finite-elements", Kind::FiniteElements),
    ("pce", Kind::Pce),
];

/// Reads the section.
pub(super) fn read(table: &mut Table<'_>) -> ModelSettings {
    let kind = table.choice(
        key(
            "model",
            "chaos in dimensionless groups, exact roots, finite elements, or the paper's Hermite chaos",
        ),
        &KINDS,
        Kind::Reduced,
    );
    let elements = table.integer(
        key("elements", "number of beam elements")
            .only(kind == Kind::FiniteElements, "model = \"finite-elements\""),
        8,
        1000,
        50,
    );
    let order = table.integer(
        key("order", "total order of the chaos").only(kind == Kind::Pce, "model = \"pce\""),
        1,
        MAX_ORDER as u64,
        5,
    );
    match kind {
        Kind::Reduced => ModelSettings::Reduced,
        Kind::Exact => ModelSettings::Exact,
        Kind::FiniteElements => ModelSettings::FiniteElements {
            elements: elements as usize,
        },
        Kind::Pce => ModelSettings::Pce {
            order: order as usize,
        },
    }
}

/// Checks that the paper's chaos can be fitted: it expands the uncertain quantities of a rod on a tensor
/// grid of (order + 1) points each.
pub(super) fn check_chaos(root: &Table<'_>, model: ModelSettings, rods: &[Option<RodConfig>]) {
    let ModelSettings::Pce { order } = model else {
        return;
    };
    for rod in rods.iter().flatten() {
        let uncertain = rod
            .analysis
            .prior
            .priors()
            .iter()
            .filter(|prior| !prior.is_fixed())
            .count();
        let points = (order as f64 + 1.0).powi(uncertain as i32);
        let id = &rod.analysis.rod;
        if uncertain == 0 {
            root.fault_of(
                "emulator",
                format!("model = \"pce\" expands uncertain quantities, rod {id} has none"),
            );
        } else if points > MAX_POINTS as f64 {
            root.fault_of(
                "emulator",
                format!(
                    "model = \"pce\" of order {order} needs {points} model solves for the {uncertain} uncertain \
                     quantities of rod {id}, at most {MAX_POINTS} are made: lower the order or fix a quantity"
                ),
            );
        }
    }
}
