//! `[record]`: settings of cutting samples into records and of refusing records.

use super::range::Range;
use super::reader::{Table, key};
use crate::analysis::signal::record::time::DAY_S;
use crate::analysis::signal::record::{Cut, RecordSettings};

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Auto,
    File,
    Window,
    FreeDecay,
}

const KINDS: [(&str, Kind); 4] = [
    ("auto", Kind::Auto),
    ("file", Kind::File),
    ("window", Kind::Window),
    ("free-decay", Kind::FreeDecay),
];

/// Shortest and longest record that may be configured \[s\].
const SHORTEST: f64 = 1e-3;

/// Reads the section.
pub(super) fn read(table: &mut Table<'_>) -> RecordSettings {
    let default = RecordSettings::default();
    let kind = table.choice(
        key(
            "cut",
            "where a record begins and ends, and so how the rod is excited: per file and gap (auto: recognised; file: ambient), in fixed windows (recognised), or at each onset of a free decay; live streams are cut every 600 s by auto",
        ),
        &KINDS,
        Kind::Auto,
    );
    let length = Range::within(SHORTEST, DAY_S);
    let window_s = table.number(
        key("window_s", "length of a window [s]").only(kind == Kind::Window, "cut = \"window\""),
        length,
        60.0,
    );
    let is_decay = kind == Kind::FreeDecay;
    let ratio = table.number(
        key(
            "onset_ratio",
            "an onset is where the short-term level exceeds the long-term level this many times",
        )
        .only(is_decay, "cut = \"free-decay\""),
        Range::within(1.5, 1e6),
        5.0,
    );
    let decay_s = table.number(
        key("decay_s", "longest free decay kept as one record [s]").only(is_decay, "cut = \"free-decay\""),
        length,
        60.0,
    );
    let cut = match kind {
        Kind::Auto => Cut::Auto,
        Kind::File => Cut::File,
        Kind::Window => Cut::Window { length_s: window_s },
        Kind::FreeDecay => Cut::FreeDecay {
            ratio,
            length_s: decay_s,
        },
    };
    let min_duration_s = table.number(
        key("min_duration_s", "shortest record analysed [s]"),
        length,
        default.min_duration_s,
    );
    let max_duration_s = table.number(
        key(
            "max_duration_s",
            "longest record held in memory; a longer stretch is cut here [s]",
        ),
        length,
        default.max_duration_s,
    );
    let share = Range::within(0.0, 0.5);
    let settings = RecordSettings {
        cut,
        min_duration_s,
        max_duration_s,
        max_gap_s: table.number(
            key(
                "max_gap_s",
                "a longer hole between samples ends a record, a shorter one is filled [s]",
            ),
            Range::within(0.0, 60.0),
            default.max_gap_s,
        ),
        max_missing: table.number(
            key(
                "max_missing",
                "largest share of missing or not finite samples [-]",
            ),
            share,
            default.max_missing,
        ),
        max_clipped: table.number(
            key(
                "max_clipped",
                "largest share of samples at the sensor's rails [-]",
            ),
            share,
            default.max_clipped,
        ),
        max_held: table.number(
            key(
                "max_held",
                "largest share of samples that repeat the one before [-]",
            ),
            Range::within(0.0, 0.99),
            default.max_held,
        ),
        max_jitter: table.number(
            key(
                "max_jitter",
                "largest scatter of the stamps about an even grid, in sample intervals [-]",
            ),
            Range::within(0.0, 1.0),
            default.max_jitter,
        ),
        max_rate_error: table.number(
            key(
                "max_rate_error",
                "largest relative difference of declared and measured sample rate [-]",
            ),
            Range::above(0.0, 0.1),
            default.max_rate_error,
        ),
    };
    if max_duration_s < min_duration_s {
        table.fault_of(
            "max_duration_s",
            format!("{max_duration_s} s is less than min_duration_s = {min_duration_s} s"),
        );
    }
    let longest = [
        ("window_s", window_s, kind == Kind::Window),
        ("decay_s", decay_s, is_decay),
    ];
    for (name, seconds, applies) in longest {
        if applies && !(min_duration_s..=max_duration_s).contains(&seconds) {
            table.fault_of(
                name,
                format!("{seconds} s lies outside min_duration_s = {min_duration_s} to max_duration_s = {max_duration_s}"),
            );
        }
    }
    settings
}
