//! A rod's quantities: plausible ranges, priors, fixed values.

use super::range::{Range, toml_float};
use super::reader::{Absent, Key, Table, key};
use super::value::Value;
use crate::analysis::rod::beam::Quantity;
use crate::analysis::rod::fixity::Fixity;
use crate::analysis::rod::prior::Prior;

/// Meaning of the quantity, with its unit.
pub(super) fn meaning(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::AxialForce => "axial force, tension positive [N]",
        Quantity::YoungsModulus => "Young's modulus [Pa]",
        Quantity::Density => "mass density [kg/m^3]",
        Quantity::Side => "side of the square section [m]",
        Quantity::Diameter => "diameter of the round section [m]",
        Quantity::Width => "width of the rectangle, across the plane of vibration [m]",
        Quantity::Height => "height of the rectangle, in the plane of vibration [m]",
        Quantity::FlexuralRigidity => "flexural rigidity EI [N m^2]",
        Quantity::MassPerLength => "mass per length [kg/m]",
        Quantity::SpringLeft => "rotational stiffness of the left support, 0 is a hinge [N m/rad]",
        Quantity::SpringRight => "rotational stiffness of the right support, 0 is a hinge [N m/rad]",
        Quantity::Length => "free length [m]",
    }
}

/// Values that a tensioned rod, cable, wire or string may have, from a thread on a bench to a bridge's cable.
/// The limits catch wrong units where they can: t/m^3, MPa, GPa, and dimensions in mm.
pub(super) fn sane(quantity: Quantity) -> Range {
    match quantity {
        Quantity::AxialForce => Range::within(1e-4, 1e9),
        Quantity::YoungsModulus => Range::within(1e6, 1e13),
        Quantity::Density => Range::within(10.0, 30_000.0),
        Quantity::Side | Quantity::Diameter | Quantity::Width | Quantity::Height => Range::within(1e-6, 2.0),
        Quantity::FlexuralRigidity => Range::within(1e-12, 1e12),
        Quantity::MassPerLength => Range::within(1e-7, 1e5),
        Quantity::SpringLeft | Quantity::SpringRight => Range::within(0.0, 1e12),
        Quantity::Length => Range::within(0.01, 2000.0),
    }
}

/// The key of a quantity.
pub(super) fn quantity_key(quantity: Quantity) -> Key {
    key(quantity.key(), meaning(quantity))
}

/// Takes the prior of one quantity, which is required.
pub(super) fn take(table: &mut Table<'_>, quantity: Quantity) -> Option<Prior> {
    let allowed = format!(
        "{}; a number or a distribution",
        sane(quantity).of(quantity.key())
    );
    table.take(
        quantity_key(quantity),
        allowed,
        Absent::Required,
        |value| read(value, quantity),
        show,
    )
}

/// Scale in which a range is uniform.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Scale {
    Value,
    Logarithm,
}

/// Forms of a distribution, for the error message.
const FORMS: &str = "wants { mean, cv }, { mean, sd }, { median, log_sd }, { low, high } or, of a support, { fixity_low, fixity_high }";

/// Reads a prior: a fixed number, `{ mean, cv }`, `{ mean, sd }`, `{ median, log_sd }`, `{ low, high }` or
/// `{ fixity_low, fixity_high }`.
fn read(value: &Value<'_>, quantity: Quantity) -> Option<Prior> {
    let range = sane(quantity);
    if !value.is_table() {
        return value.number(range).map(|value| Prior::Fixed { value });
    }
    value.inline(|table| {
        if table.has("cv") && table.has("sd") {
            table.ignore(&["mean", "cv", "sd"]);
            table.fault("has both cv and sd, one of them is wanted");
            return None;
        }
        let form = [
            "cv",
            "sd",
            "mean",
            "log_sd",
            "median",
            "low",
            "high",
            "fixity_low",
            "fixity_high",
        ]
        .into_iter()
        .find(|name| table.has(name));
        if let Some("fixity_low" | "fixity_high") = form {
            return fixity(table, quantity);
        }
        let mut required =
            |name, meaning, range| table.maybe_number(key(name, meaning), range, Absent::Required);
        match form {
            Some("cv" | "mean") => {
                let mean = required("mean", "mean before truncation", range);
                let cv = required("cv", "coefficient of variation", Range::above(0.0, 1.0));
                let (mean, cv) = (mean?, cv?);
                if mean <= 0.0 {
                    table.fault("a mean of 0 wants no distribution: write the number 0 itself");
                    return None;
                }
                Some(Prior::TruncatedNormal { mean, sd: cv * mean })
            }
            Some("sd") => {
                let mean = required("mean", "mean before truncation", range);
                let sd = required(
                    "sd",
                    "standard deviation before truncation",
                    Range::above(0.0, 1e12),
                );
                let (mean, sd) = (mean?, sd?);
                if sd > mean {
                    table.fault(format!(
                        "sd = {sd} is larger than mean = {mean}: a prior that wide says nothing"
                    ));
                    return None;
                }
                Some(Prior::TruncatedNormal { mean, sd })
            }
            Some("log_sd" | "median") => {
                let median = required("median", "median", range);
                let log_sd = required(
                    "log_sd",
                    "standard deviation of the logarithm",
                    Range::above(0.0, 3.0),
                );
                let (median, log_sd) = (median?, log_sd?);
                if median <= 0.0 {
                    table.fault("a median of 0 wants no distribution: write the number 0 itself");
                    return None;
                }
                Some(Prior::LogNormal { median, log_sd })
            }
            Some(_) => {
                let low = required("low", "lower end", range);
                let high = required("high", "upper end", range);
                let (low, high) = (low?, high?);
                let scale = table.choice(
                    key("even_in", "scale in which the range is even"),
                    &[("value", Scale::Value), ("logarithm", Scale::Logarithm)],
                    Scale::Value,
                );
                if low >= high {
                    table.fault(format!("low = {low} is not below high = {high}"));
                    return None;
                }
                match scale {
                    Scale::Value => Some(Prior::Uniform { low, high }),
                    Scale::Logarithm if low > 0.0 => Some(Prior::LogUniform { low, high }),
                    Scale::Logarithm => {
                        table.fault("even_in = \"logarithm\" wants low above 0");
                        None
                    }
                }
            }
            None => {
                table.ignore(&[
                    "mean",
                    "cv",
                    "sd",
                    "median",
                    "log_sd",
                    "low",
                    "high",
                    "even_in",
                    "fixity_low",
                    "fixity_high",
                    "ends",
                ]);
                table.fault(FORMS);
                None
            }
        }
    })
}

/// Reads a support by its fixity; its stiffness is set once the other priors are known.
fn fixity(table: &mut Table<'_>, quantity: Quantity) -> Option<Prior> {
    if !matches!(quantity, Quantity::SpringLeft | Quantity::SpringRight) {
        table.ignore(&["fixity_low", "fixity_high", "ends"]);
        table.fault("a fixity is a prior of a support alone");
        return None;
    }
    let range = Range::within(0.0, Fixity::MOST);
    let low = table.maybe_number(
        key("fixity_low", "lowest fixity, 0 is a hinge [-]"),
        range,
        Absent::Required,
    );
    let high = table.maybe_number(
        key("fixity_high", "highest fixity, 1 would be a clamp [-]"),
        range,
        Absent::Required,
    );
    let ends = table.number(
        key(
            "ends",
            "weight of hinge and clamp against the middle; 1 is even [-]",
        ),
        Range::within(0.1, 10.0),
        1.0,
    );
    let (low, high) = (low?, high?);
    if low >= high {
        table.fault(format!("fixity_low = {low} is not below fixity_high = {high}"));
        return None;
    }
    Some(Prior::Fixity(Fixity {
        low,
        high,
        ends,
        unit_n_m: 1.0,
    }))
}

/// The prior as TOML that reads back to the same bits.
pub(super) fn show(prior: &Prior) -> String {
    let number = |value: f64| toml_float(value);
    match *prior {
        Prior::Fixed { value } => number(value),
        Prior::TruncatedNormal { mean, sd } => {
            let rounded: f64 = format!("{:.4}", sd / mean).parse().unwrap_or(0.0);
            if rounded > 0.0 && rounded * mean == sd {
                format!("{{ mean = {}, cv = {} }}", number(mean), number(rounded))
            } else {
                format!("{{ mean = {}, sd = {} }}", number(mean), number(sd))
            }
        }
        Prior::LogNormal { median, log_sd } => {
            format!("{{ median = {}, log_sd = {} }}", number(median), number(log_sd))
        }
        Prior::Uniform { low, high } => format!("{{ low = {}, high = {} }}", number(low), number(high)),
        Prior::LogUniform { low, high } => format!(
            "{{ low = {}, high = {}, even_in = \"logarithm\" }}",
            number(low),
            number(high)
        ),
        Prior::Fixity(fixity) => format!(
            "{{ fixity_low = {}, fixity_high = {}, ends = {} }}",
            number(fixity.low),
            number(fixity.high),
            number(fixity.ends)
        ),
    }
}
