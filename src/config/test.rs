//! `[[rod.test]]`: tests and measurements of a rod at one moment. Their information about everything but the
//! axial force applies to every record, that about the force only to the records of that moment.

use super::datum::{self, Kind};
use super::range::{Range, toml_string};
use super::reader::{Absent, Table, key};
use super::value::{Value, toml_floats};
use crate::analysis::identify::RodTest;
use crate::analysis::inference::joint::Datum;
use crate::analysis::rod::beam::Quantity;
use crate::analysis::rod::beam::forward::MAX_MODES;
use crate::analysis::rod::beam::receptance::PointMass;
use crate::analysis::rod::prior::{Prior, RodPrior};
use crate::analysis::rod::query::Query;

/// Time within which a record pairs with a test if it states none \[h\].
const PAIRS_WITHIN_H: f64 = 1.0;

/// Reads all tests of one rod; those with a fault are left out.
pub(super) fn read_all(table: &mut Table<'_>, prior: Option<&RodPrior>) -> Vec<Option<RodTest>> {
    table.list("test", "Tests of the rod at one moment.", |table| {
        read(table, prior)
    })
}

fn read(table: &mut Table<'_>, prior: Option<&RodPrior>) -> Option<RodTest> {
    let time = table.take(
        key("time", "when it was measured"),
        "a time with an offset, 2026-03-01T06:00:00Z",
        Absent::Required,
        Value::time,
        |time| toml_string(&time.to_string()),
    );
    let pairs_within_h = table.number(
        key(
            "pairs_within_h",
            "a record that begins within so much of the test has the test's force [h]",
        ),
        Range::within(0.0, 240.0),
        PAIRS_WITHIN_H,
    );
    let frequencies = frequencies(
        table,
        (
            "frequencies_hz",
            "natural frequencies of that moment, modes 1, 2 ... [Hz]",
        ),
        ("sd_hz", "their standard errors, one for all or one each [Hz]"),
    );
    let length_m = prior
        .and_then(|prior| prior.of(Quantity::Length))
        .map_or(f64::NAN, Prior::centre);
    let mut data = Vec::new();
    let mut is_good = frequencies.is_some();
    for kind in [Kind::Load, Kind::Mass, Kind::Strain, Kind::Shape, Kind::Measured] {
        let read = texts(table, kind, |value, text| {
            let datum = datum::datum(kind, text, length_m)
                .map_err(|why| value.fault(why))
                .ok()?;
            checked(value, datum, prior)
        });
        is_good &= read.is_some();
        data.extend(read.unwrap_or_default());
    }
    let loaded = loaded(table, length_m, prior);
    is_good &= loaded.is_some();
    data.extend(
        frequencies
            .unwrap_or_default()
            .into_iter()
            .map(|(order, f, sd)| Datum::frequency(order, f, sd)),
    );
    data.extend(loaded.unwrap_or_default());
    let is_empty = !Kind::ALL.iter().any(|kind| table.has(kind.key()));
    if data.is_empty() && is_good && is_empty {
        table.fault("holds no measurement: load, mass, strain, shape, measured or frequencies_hz is wanted");
        return None;
    }
    is_good.then_some(RodTest {
        time: time?,
        pairs_within_s: 3600.0 * pairs_within_h,
        data,
    })
}

fn checked(value: &Value<'_>, datum: Datum, prior: Option<&RodPrior>) -> Option<Datum> {
    datum
        .check(prior?)
        .map_err(|fault| value.fault(fault.to_string()))
        .ok()?;
    Some(datum)
}

/// A key that is one text or a list of them.
fn texts(
    table: &mut Table<'_>,
    kind: Kind,
    read: impl Fn(&Value<'_>, &str) -> Option<Datum>,
) -> Option<Vec<Datum>> {
    let meaning = match kind {
        Kind::Load => "load across the rod and the deflection under it, at rest or just before its release",
        Kind::Mass => "frequency ratio with a mass on the rod",
        Kind::Strain => "strain amplitude over displacement amplitude in a mode [1/m]",
        Kind::Shape => "modal displacements at two places, with their sign",
        Kind::Measured => "readings of one of the rod's quantities",
    };
    let all = table.take(
        key(kind.key(), meaning),
        format!("\"{}\", or a list of such", kind.example()),
        Absent::Default((Vec::new(), Vec::new())),
        |value| {
            let values = match value.is_array() {
                true => value.array()?,
                false => {
                    return value
                        .string()
                        .and_then(|text| Some((vec![read(value, text)?], vec![text.to_owned()])));
                }
            };
            let parts: Option<Vec<(Datum, String)>> = values
                .iter()
                .map(|value| {
                    let text = value.string()?;
                    Some((read(value, text)?, text.to_owned()))
                })
                .collect();
            Some(parts?.into_iter().unzip())
        },
        |(_, texts): &(Vec<Datum>, Vec<String>)| {
            let quoted: Vec<String> = texts.iter().map(|text| toml_string(text)).collect();
            format!("[{}]", quoted.join(", "))
        },
    );
    all.map(|(data, _)| data)
}

/// Frequencies with their errors; `None` for a fault, empty for none given.
fn frequencies(
    table: &mut Table<'_>,
    (name, meaning): (&'static str, &'static str),
    (sd_name, sd_meaning): (&'static str, &'static str),
) -> Option<Vec<(usize, f64, f64)>> {
    let range = Range::above(0.0, 1e5);
    let given = table.has(name);
    let list = table.take(
        key(name, meaning),
        "1 to 5 ascending numbers; 0 where a mode was not measured",
        Absent::Nothing("none were measured then"),
        |value| {
            let list = value.numbers(Range::within(0.0, 1e5), 1, MAX_MODES)?;
            let measured: Vec<f64> = list.iter().copied().filter(|f| *f > 0.0).collect();
            if measured.is_empty() || measured.windows(2).any(|pair| pair[0] >= pair[1]) {
                value.fault("must ascend, with at least one above 0");
                return None;
            }
            Some(list)
        },
        |list| toml_floats(list),
    );
    let sds = table.take(
        key(sd_name, sd_meaning).only(given, name),
        "above 0; a number, or a list as long as the frequencies",
        Absent::Required,
        |value| match value.is_array() {
            true => value.numbers(range, 1, MAX_MODES),
            false => value.number(range).map(|sd| vec![sd]),
        },
        |list| toml_floats(list),
    );
    if !given {
        return Some(Vec::new());
    }
    let (list, sds) = (list?, sds?);
    if sds.len() != 1 && sds.len() != list.len() {
        table.fault_of(
            sd_name,
            format!("has {} entries, {name} {}", sds.len(), list.len()),
        );
        return None;
    }
    let sd_of = |i: usize| if sds.len() == 1 { sds[0] } else { sds[i] };
    let measured = list.iter().enumerate().filter(|(_, f)| **f > 0.0);
    Some(measured.map(|(i, &f)| (i + 1, f, sd_of(i))).collect())
}

/// Frequencies with a mass on the rod.
fn loaded(table: &mut Table<'_>, length_m: f64, prior: Option<&RodPrior>) -> Option<Vec<Datum>> {
    let given = table.has("loaded_frequencies_hz");
    let mass: Option<(PointMass, String)> = table.take(
        key("loaded_with", "the mass on the rod and its place").only(given, "loaded_frequencies_hz"),
        "\"20kg@0.3L\"",
        Absent::Required,
        |value| {
            let text = value.string()?;
            let mass = datum::mass(text, length_m).map_err(|why| value.fault(why)).ok()?;
            let query = Query::Frequency {
                order: 1,
                mass: Some(mass),
            };
            let (value_hz, sd) = (1.0, 0.1);
            checked(
                value,
                Datum {
                    query,
                    value: value_hz,
                    sd,
                    gain_sd: 0.0,
                },
                prior,
            )?;
            Some((mass, text.to_owned()))
        },
        |(_, text)| toml_string(text),
    );
    let frequencies = frequencies(
        table,
        (
            "loaded_frequencies_hz",
            "natural frequencies with the mass on the rod, modes 1, 2 ... [Hz]",
        ),
        (
            "loaded_sd_hz",
            "their standard errors, one for all or one each [Hz]",
        ),
    )?;
    if !given {
        return Some(Vec::new());
    }
    let (mass, _) = mass?;
    let datum = |(order, value, sd)| Datum {
        query: Query::Frequency {
            order,
            mass: Some(mass),
        },
        value,
        sd,
        gain_sd: 0.0,
    };
    Some(frequencies.into_iter().map(datum).collect())
}
