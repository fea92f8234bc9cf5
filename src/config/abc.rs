//! `[abc]`: settings of the inference of the axial force.

use super::range::{Range, toml_float};
use super::reader::{Absent, Table, key};
use super::value::Value;
use crate::analysis::inference::{AbcSettings, Accept, Adjustment, Distance, Method, Noise};

const DISTANCES: [(&str, Distance); 3] = [
    ("euclidean", Distance::Euclidean),
    ("relative", Distance::Relative),
    ("mahalanobis", Distance::Mahalanobis),
];
const METHODS: [(&str, Method); 2] = [
    ("rejection", Method::Rejection),
    ("sequential", Method::Sequential),
];
const ADJUSTMENTS: [(&str, Adjustment); 2] = [("none", Adjustment::None), ("linear", Adjustment::Linear)];

/// Fewest accepted draws of a usable posterior.
const FEWEST_ACCEPTED: f64 = 50.0;

/// Reads the section.
pub(super) fn read(table: &mut Table<'_>) -> AbcSettings {
    let default = AbcSettings::default();
    let draws = table.integer(
        key("draws", "draws from the prior"),
        1_000,
        100_000_000,
        default.draws as u64,
    );
    let accept = table
        .take(
            key(
                "accept",
                "which draws are accepted: the nearest share, or all nearer than epsilon",
            ),
            "{ quantile = q }, 0 < q <= 1, or { epsilon = e }, 0 < e <= 1e6",
            Absent::Default(default.accept),
            accept,
            |accept| match accept {
                Accept::Quantile(share) => format!("{{ quantile = {} }}", toml_float(*share)),
                Accept::Epsilon(epsilon) => format!("{{ epsilon = {} }}", toml_float(*epsilon)),
            },
        )
        .unwrap_or(default.accept);
    if let Accept::Quantile(share) = accept
        && share * (draws as f64) < FEWEST_ACCEPTED
    {
        table.fault_of(
            "accept",
            format!("a share of {share} of {draws} draws leaves fewer than {FEWEST_ACCEPTED} accepted: more draws, or a larger share"),
        );
    }
    let distance = table.choice(
        key("distance", "how far simulated frequencies are from observed ones"),
        &DISTANCES,
        default.distance,
    );
    let noise = table
        .take(
            key("noise", "measurement error of a frequency: the record's own standard errors, or one for all modes [Hz]"),
            "\"record\" or { sd_hz = s }, 0 <= s <= 10",
            Absent::Default(default.noise),
            noise,
            |noise| match noise {
                Noise::Record => "\"record\"".to_owned(),
                Noise::Fixed(sd_hz) => format!("{{ sd_hz = {} }}", toml_float(*sd_hz)),
            },
        )
        .unwrap_or(default.noise);
    AbcSettings {
        draws: draws as usize,
        accept,
        distance,
        noise,
        method: table.choice(key("method", "how draws are proposed"), &METHODS, default.method),
        adjustment: table.choice(
            key("adjustment", "what is done to the accepted draws"),
            &ADJUSTMENTS,
            default.adjustment,
        ),
    }
}

fn accept(value: &Value<'_>) -> Option<Accept> {
    value.inline(|table| match (table.has("quantile"), table.has("epsilon")) {
        (true, true) | (false, false) => {
            table.ignore(&["quantile", "epsilon"]);
            table.fault("wants either quantile or epsilon, as in { quantile = 0.01 }");
            None
        }
        (true, false) => table
            .maybe_number(
                key("quantile", "nearest share [-]"),
                Range::above(0.0, 1.0),
                Absent::Required,
            )
            .map(Accept::Quantile),
        (false, true) => table
            .maybe_number(
                key("epsilon", "tolerance [unit of the distance]"),
                Range::above(0.0, 1e6),
                Absent::Required,
            )
            .map(Accept::Epsilon),
    })
}

fn noise(value: &Value<'_>) -> Option<Noise> {
    if !value.is_table() {
        return value.choice(&[("record", Noise::Record)]);
    }
    value.inline(|table| {
        table
            .maybe_number(
                key("sd_hz", "standard deviation [Hz]"),
                Range::within(0.0, 10.0),
                Absent::Required,
            )
            .map(Noise::Fixed)
    })
}
