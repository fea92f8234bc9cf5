//! `[[simulation.rod.fault]]`: a fault of some records.

use super::super::range::Range;
use super::super::reader::{Absent, Key, Table, key};
use super::super::value::Value;
use crate::analysis::lab::synthesis::{Fault, FaultKind};

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Nan,
    Dropout,
    Held,
    Spikes,
    Clipped,
    Step,
    Scaled,
    ClockStep,
    Late,
    Jitter,
    Duplicates,
    OutOfOrder,
    Lost,
}

const KINDS: [(&str, Kind); 13] = [
    ("nan", Kind::Nan),
    ("dropout", Kind::Dropout),
    ("held", Kind::Held),
    ("spikes", Kind::Spikes),
    ("clipped", Kind::Clipped),
    ("step", Kind::Step),
    ("scaled", Kind::Scaled),
    ("clock-step", Kind::ClockStep),
    ("late", Kind::Late),
    ("jitter", Kind::Jitter),
    ("duplicates", Kind::Duplicates),
    ("out-of-order", Kind::OutOfOrder),
    ("lost", Kind::Lost),
];

/// Reads one fault; `None` if a required key is missing.
pub(super) fn read(table: &mut Table<'_>, records: usize) -> Option<Fault> {
    let kind = table.take(
        key("kind", "what goes wrong"),
        super::super::value::quoted(&KINDS.map(|(word, _)| word)),
        Absent::Required,
        |value| value.choice(&KINDS),
        |kind| {
            let word = KINDS
                .iter()
                .find(|(_, other)| other == kind)
                .map_or("", |(word, _)| *word);
            format!("\"{word}\"")
        },
    );
    let mut record = |key: Key, absent: Absent<usize>| {
        let allowed = format!("1 <= {} <= records", key.name);
        let read = |value: &Value<'_>| {
            let number = value.integer(1, u64::from(u32::MAX))? as usize;
            if number > records {
                value.fault(format!("{number} is beyond records = {records}"));
            }
            Some(number)
        };
        table.take(key, allowed, absent, read, usize::to_string)
    };
    let first_record = record(
        key("first_record", "first record it touches, from 1"),
        Absent::Default(1),
    )
    .unwrap_or(1);
    let last_record = record(
        key("last_record", "last record it touches"),
        Absent::Nothing("the last"),
    )
    .unwrap_or(records);
    if last_record < first_record {
        table.fault_of(
            "last_record",
            format!("{last_record} comes before first_record = {first_record}"),
        );
    }
    let kind = if let Some(kind) = kind {
        kind
    } else {
        table.ignore(&[
            "at_s", "length_s", "per_hour", "height_m", "level_m", "factor", "step_s", "late_s", "sd_s",
            "share",
        ]);
        return None;
    };
    let mut needed = |key: Key, of: &[Kind], condition: &'static str, range: Range| {
        table.maybe_number(key.only(of.contains(&kind), condition), range, Absent::Required)
    };
    let time = Range::within(0.0, 86_400.0);
    let at_s = needed(
        key("at_s", "begin, from the start of the record [s]"),
        &[
            Kind::Nan,
            Kind::Dropout,
            Kind::Held,
            Kind::Step,
            Kind::ClockStep,
            Kind::Late,
        ],
        "kind = \"nan\", \"dropout\", \"held\", \"step\", \"clock-step\" or \"late\"",
        time,
    );
    let length_s = needed(
        key("length_s", "duration [s]"),
        &[Kind::Nan, Kind::Dropout, Kind::Held],
        "kind = \"nan\", \"dropout\" or \"held\"",
        time,
    );
    let per_hour = needed(
        key("per_hour", "mean number in an hour [1/h]"),
        &[Kind::Spikes],
        "kind = \"spikes\"",
        Range::within(0.0, 1e6),
    );
    let height_m = needed(
        key("height_m", "height [m]"),
        &[Kind::Spikes, Kind::Step],
        "kind = \"spikes\" or \"step\"",
        Range::within(-10.0, 10.0),
    );
    let level_m = needed(
        key("level_m", "the output stays within plus and minus this [m]"),
        &[Kind::Clipped],
        "kind = \"clipped\"",
        Range::above(0.0, 1.0),
    );
    let factor = needed(
        key("factor", "factor of a wrong unit [-]"),
        &[Kind::Scaled],
        "kind = \"scaled\"",
        Range::within(-1e9, 1e9),
    );
    let step_s = needed(
        key("step_s", "by how much the clock jumps, negative is backwards [s]"),
        &[Kind::ClockStep],
        "kind = \"clock-step\"",
        Range::within(-1e9, 1e9),
    );
    let late_s = needed(
        key("late_s", "how late the message that holds at_s is stamped [s]"),
        &[Kind::Late],
        "kind = \"late\"",
        Range::within(0.0, 3600.0),
    );
    let sd_s = needed(
        key("sd_s", "standard deviation of the stamps [s]"),
        &[Kind::Jitter],
        "kind = \"jitter\"",
        Range::within(0.0, 10.0),
    );
    let share = needed(
        key("share", "share of the messages [-]"),
        &[Kind::Duplicates, Kind::OutOfOrder, Kind::Lost],
        "kind = \"duplicates\", \"out-of-order\" or \"lost\"",
        Range::within(0.0, 1.0),
    );
    let kind = match kind {
        Kind::Nan => FaultKind::Nan {
            at_s: at_s?,
            length_s: length_s?,
        },
        Kind::Dropout => FaultKind::Dropout {
            at_s: at_s?,
            length_s: length_s?,
        },
        Kind::Held => FaultKind::Held {
            at_s: at_s?,
            length_s: length_s?,
        },
        Kind::Spikes => FaultKind::Spikes {
            per_hour: per_hour?,
            height_m: height_m?,
        },
        Kind::Clipped => FaultKind::Clipped { level_m: level_m? },
        Kind::Step => FaultKind::Step {
            at_s: at_s?,
            height_m: height_m?,
        },
        Kind::Scaled => FaultKind::Scaled { factor: factor? },
        Kind::ClockStep => FaultKind::ClockStep {
            at_s: at_s?,
            step_s: step_s?,
        },
        Kind::Late => FaultKind::Late {
            at_s: at_s?,
            late_s: late_s?,
        },
        Kind::Jitter => FaultKind::Jitter { sd_s: sd_s? },
        Kind::Duplicates => FaultKind::Duplicates { share: share? },
        Kind::OutOfOrder => FaultKind::OutOfOrder { share: share? },
        Kind::Lost => FaultKind::Lost { share: share? },
    };
    Some(Fault {
        kind,
        first_record,
        last_record,
    })
}
