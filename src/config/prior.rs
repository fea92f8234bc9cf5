//! A rod's quantities: their sane ranges, their priors, their fixed values.

use super::range::{Range, toml_float};
use super::reader::{Absent, Key, Table, key};
use super::value::Value;
use crate::bayes::Prior;
use crate::beam::Quantity;

/// What the quantity is, with its unit.
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

/// Values that a tensioned rod, cable, wire or string may have, from a thread on a bench to a bridge's cable. Where one can be told
/// from a slip of the unit, the limit catches it: t/m^3, MPa, GPa, and dimensions in mm.
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

/// Takes the prior of one quantity, which must be there.
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

/// A fixed number, `{ mean, cv }`, `{ mean, sd }`, `{ median, log_sd }` or `{ low, high }`.
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
        let form = ["cv", "sd", "mean", "log_sd", "median", "low", "high"]
            .into_iter()
            .find(|name| table.has(name));
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
                if low >= high {
                    table.fault(format!("low = {low} is not below high = {high}"));
                    return None;
                }
                Some(Prior::Uniform { low, high })
            }
            None => {
                table.ignore(&["mean", "cv", "sd", "median", "log_sd", "low", "high"]);
                table.fault("wants { mean, cv }, { mean, sd }, { median, log_sd } or { low, high }");
                None
            }
        }
    })
}

/// The prior as TOML that reads back as the same bits.
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
    }
}
