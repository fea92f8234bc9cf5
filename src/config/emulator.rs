//! `[emulator]`: which forward model answers for the natural frequencies.

use super::reader::{Table, key};
use crate::emulator::ModelSettings;

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

/// The section.
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
        8,
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
