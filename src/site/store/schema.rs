//! The tables, and the steps from one format to the next. docs/store.md describes every column.

use super::row::Row;
use super::{change, columns, resonance};
use rusqlite::types::Value;
use rusqlite::{Connection, Transaction};

/// Application id in the header of every store: `Tira`.
pub(super) const APPLICATION_ID: i64 = 0x5469_7261;

/// One step from a format to the next.
type Step = fn(&Transaction<'_>) -> rusqlite::Result<()>;

/// The steps in order: a store of format `n` has undergone the first `n`. Steps are only ever added; the
/// tests hold a golden store of each released format.
const STEPS: [Step; 7] = [first, second, third, fourth, fifth, sixth, seventh];

/// Format written by this program.
pub(super) const FORMAT: i64 = STEPS.len() as i64;

/// Brings a store of format `from` to [`FORMAT`].
pub(super) fn migrate(connection: &mut Connection, from: i64) -> rusqlite::Result<()> {
    let transaction = connection.transaction()?;
    let seen = usize::try_from(from).unwrap_or(0);
    for step in STEPS.iter().skip(seen) {
        step(&transaction)?;
    }
    transaction.pragma_update(None, "application_id", APPLICATION_ID)?;
    transaction.pragma_update(None, "user_version", FORMAT)?;
    transaction.commit()
}

/// Definition of every table and index in the store.
pub(super) fn definitions(connection: &Connection) -> rusqlite::Result<Vec<(String, String)>> {
    let mut statement =
        connection.prepare("SELECT name, sql FROM sqlite_schema WHERE sql IS NOT NULL ORDER BY name")?;
    let rows = statement.query_map((), |row| Ok((row.get(0)?, row.get(1)?)))?;
    rows.collect()
}

/// Tables whose rows have a checksum, in an order in which rows can be inserted.
pub(super) const TABLES: [&str; 26] = [
    "config",
    "rod",
    "segment",
    "state",
    "record",
    "line",
    "mode",
    "resonance",
    "period",
    "snapshot",
    "alarm",
    "outbox",
    "request",
    "source",
    "file",
    "carry",
    "delivery",
    "expected",
    "notice",
    "alive",
    "shelf",
    "origin",
    "epoch",
    "change",
    "ended",
    "gathered",
];

/// True if a table exists: an older format has fewer.
pub(super) fn has(connection: &Connection, table: &str) -> rusqlite::Result<bool> {
    connection
        .prepare_cached("SELECT count(*) FROM sqlite_schema WHERE type = 'table' AND name = ?")?
        .query_row([table], |row| row.get::<_, i64>(0))
        .map(|count| count > 0)
}

/// Tables that grow with days rather than with records.
pub(super) const SMALL: [&str; 9] = [
    "config", "rod", "segment", "state", "period", "snapshot", "alarm", "outbox", "request",
];

/// Tables of results: equal for the same records, however often a run was killed and restarted.
pub(super) const RESULTS: [&str; 11] = [
    "config", "rod", "segment", "state", "record", "line", "mode", "period", "snapshot", "alarm", "outbox",
];

fn first(transaction: &Transaction<'_>) -> rusqlite::Result<()> {
    transaction.execute_batch(FIRST)?;
    transaction.execute_batch(&format!(
        "CREATE TABLE record (
            id INTEGER PRIMARY KEY,
            rod TEXT NOT NULL,
            identity BLOB NOT NULL,
            start_ns INTEGER,
            {},
            rms REAL,
            emulator TEXT,
            checksum INTEGER NOT NULL,
            UNIQUE (rod, identity),
            FOREIGN KEY (config) REFERENCES config (hash)
        ) STRICT;
        CREATE INDEX record_in_time ON record (rod, start_ns);",
        columns::definitions()
    ))
}

/// Second format: tables for a daemon's sources and sinks.
fn second(transaction: &Transaction<'_>) -> rusqlite::Result<()> {
    transaction.execute_batch(
        "CREATE TABLE file (
            name TEXT PRIMARY KEY,
            size INTEGER NOT NULL,
            modified_ns INTEGER NOT NULL,
            state TEXT NOT NULL,
            detail TEXT,
            checksum INTEGER NOT NULL
        ) STRICT;

        CREATE TABLE carry (
            journal TEXT PRIMARY KEY,
            part INTEGER NOT NULL,
            body BLOB NOT NULL,
            checksum INTEGER NOT NULL
        ) STRICT;

        CREATE TABLE delivery (
            sink TEXT PRIMARY KEY,
            through INTEGER NOT NULL,
            checksum INTEGER NOT NULL
        ) STRICT;",
    )
}

/// Third format: the drift watch's evidence in place of the sums of two charts.
fn third(transaction: &Transaction<'_>) -> rusqlite::Result<()> {
    const KEPT: [&str; 16] = [
        "rod",
        "segment",
        "period",
        "start",
        "start_ns",
        "records",
        "delta",
        "delta_sd",
        "not_axial_p",
        "temperature_c",
        "expected",
        "expected_sd",
        "residual",
        "leverage",
        "at_reference",
        "at_reference_sd",
    ];
    transaction.execute_batch(&format!("ALTER TABLE period RENAME TO charted; {PERIOD}"))?;
    let mut statement = transaction.prepare("SELECT * FROM charted")?;
    let mut rows = statement.query(())?;
    while let Some(before) = rows.next()? {
        let mut row = Row::of("period");
        for column in KEPT {
            row.put(column, before.get::<_, Value>(column)?);
        }
        for column in ["evidence", "evidence_peers", "evidence_blind"] {
            row.put(column, Value::Null);
        }
        row.put("json", before.get::<_, Value>("json")?);
        row.insert(transaction)?;
    }
    drop(rows);
    drop(statement);
    transaction.execute_batch("DROP TABLE charted;")
}

/// Fourth format: a daemon's own watch, and the states of rods whose settings may come back.
fn fourth(transaction: &Transaction<'_>) -> rusqlite::Result<()> {
    transaction.execute_batch(
        "CREATE TABLE expected (
            rod TEXT PRIMARY KEY,
            since TEXT NOT NULL,
            checksum INTEGER NOT NULL
        ) STRICT;

        CREATE TABLE notice (
            number INTEGER PRIMARY KEY,
            condition TEXT NOT NULL,
            fault TEXT NOT NULL,
            about TEXT NOT NULL,
            what TEXT NOT NULL,
            raised TEXT NOT NULL,
            time TEXT NOT NULL,
            detail TEXT NOT NULL,
            checksum INTEGER NOT NULL
        ) STRICT;
        CREATE INDEX notice_of_condition ON notice (condition, what);

        CREATE TABLE alive (
            number INTEGER PRIMARY KEY,
            from_ns INTEGER NOT NULL,
            to_ns INTEGER NOT NULL,
            checksum INTEGER NOT NULL
        ) STRICT;

        CREATE TABLE shelf (
            rod TEXT NOT NULL,
            segment INTEGER NOT NULL,
            key TEXT NOT NULL,
            json TEXT NOT NULL,
            checksum INTEGER NOT NULL,
            PRIMARY KEY (rod, segment)
        ) STRICT;",
    )
}

/// Fifth format: findings of every record's samples, for an analysis without them, and the file each record came from.
fn fifth(transaction: &Transaction<'_>) -> rusqlite::Result<()> {
    resonance::add_table(transaction)?;
    transaction.execute_batch(
        "CREATE TABLE origin (
            record INTEGER PRIMARY KEY,
            file TEXT NOT NULL,
            checksum INTEGER NOT NULL,
            FOREIGN KEY (record) REFERENCES record (id)
        ) STRICT;",
    )
}

/// Sixth format: a log of changes, for copies of the store elsewhere.
fn sixth(transaction: &Transaction<'_>) -> rusqlite::Result<()> {
    change::add_tables(transaction)
}

/// Seventh format: at a centre, what is told no longer, and the sign of a copy that nothing goes on with. Neither is sent.
fn seventh(transaction: &Transaction<'_>) -> rusqlite::Result<()> {
    transaction.execute_batch(
        "CREATE INDEX outbox_of_alarm ON outbox (alarm);

        CREATE TABLE ended (
            id TEXT PRIMARY KEY,
            checksum INTEGER NOT NULL
        ) STRICT;

        CREATE TABLE gathered (
            site TEXT PRIMARY KEY,
            checksum INTEGER NOT NULL
        ) STRICT;",
    )
}

const PERIOD: &str = "
CREATE TABLE period (
    rod TEXT NOT NULL,
    segment INTEGER NOT NULL,
    period INTEGER NOT NULL,
    start TEXT NOT NULL,
    start_ns INTEGER NOT NULL,
    records INTEGER NOT NULL,
    delta REAL NOT NULL,
    delta_sd REAL NOT NULL,
    not_axial_p REAL NOT NULL,
    temperature_c REAL,
    expected REAL,
    expected_sd REAL,
    residual REAL,
    leverage REAL,
    at_reference REAL,
    at_reference_sd REAL,
    evidence REAL,
    evidence_peers REAL,
    evidence_blind REAL,
    json TEXT NOT NULL,
    checksum INTEGER NOT NULL,
    PRIMARY KEY (rod, segment, period),
    FOREIGN KEY (rod, segment) REFERENCES segment (rod, number)
) STRICT;";

const FIRST: &str = "
CREATE TABLE config (
    hash TEXT PRIMARY KEY,
    site TEXT NOT NULL,
    effective TEXT NOT NULL,
    checksum INTEGER NOT NULL
) STRICT;

CREATE TABLE rod (
    rod TEXT PRIMARY KEY,
    state TEXT NOT NULL,
    detail TEXT NOT NULL,
    since TEXT,
    segment INTEGER NOT NULL,
    checksum INTEGER NOT NULL
) STRICT;

CREATE TABLE segment (
    rod TEXT NOT NULL,
    number INTEGER NOT NULL,
    reason TEXT NOT NULL,
    key TEXT NOT NULL,
    baseline_first TEXT,
    baseline_last TEXT,
    baseline_records INTEGER,
    reference_c REAL,
    fault TEXT,
    json TEXT NOT NULL,
    checksum INTEGER NOT NULL,
    PRIMARY KEY (rod, number)
) STRICT;

CREATE TABLE state (
    rod TEXT NOT NULL,
    part TEXT NOT NULL,
    json TEXT NOT NULL,
    checksum INTEGER NOT NULL,
    PRIMARY KEY (rod, part)
) STRICT;

CREATE TABLE line (
    record INTEGER PRIMARY KEY REFERENCES record (id),
    json TEXT NOT NULL,
    checksum INTEGER NOT NULL
) STRICT;

CREATE TABLE mode (
    record INTEGER NOT NULL REFERENCES record (id),
    mode_order INTEGER NOT NULL,
    frequency_hz REAL NOT NULL,
    sd_hz REAL NOT NULL,
    damping REAL,
    checksum INTEGER NOT NULL,
    PRIMARY KEY (record, mode_order)
) STRICT, WITHOUT ROWID;

CREATE TABLE period (
    rod TEXT NOT NULL,
    segment INTEGER NOT NULL,
    period INTEGER NOT NULL,
    start TEXT NOT NULL,
    start_ns INTEGER NOT NULL,
    records INTEGER NOT NULL,
    delta REAL NOT NULL,
    delta_sd REAL NOT NULL,
    not_axial_p REAL NOT NULL,
    temperature_c REAL,
    expected REAL,
    expected_sd REAL,
    residual REAL,
    leverage REAL,
    at_reference REAL,
    at_reference_sd REAL,
    step_up REAL,
    step_down REAL,
    ramp_up REAL,
    ramp_down REAL,
    json TEXT NOT NULL,
    checksum INTEGER NOT NULL,
    PRIMARY KEY (rod, segment, period),
    FOREIGN KEY (rod, segment) REFERENCES segment (rod, number)
) STRICT;

CREATE TABLE snapshot (
    rod TEXT NOT NULL,
    number INTEGER NOT NULL,
    start_ns INTEGER NOT NULL,
    json TEXT NOT NULL,
    checksum INTEGER NOT NULL,
    PRIMARY KEY (rod, number)
) STRICT;

CREATE TABLE alarm (
    id TEXT PRIMARY KEY,
    rod TEXT NOT NULL,
    kind TEXT NOT NULL,
    raised TEXT NOT NULL,
    raised_ns INTEGER NOT NULL,
    message TEXT NOT NULL,
    acknowledged TEXT,
    cleared TEXT,
    stands INTEGER NOT NULL,
    json TEXT NOT NULL,
    checksum INTEGER NOT NULL
) STRICT;

CREATE TABLE outbox (
    number INTEGER PRIMARY KEY,
    alarm TEXT NOT NULL REFERENCES alarm (id),
    rod TEXT NOT NULL,
    what TEXT NOT NULL,
    time TEXT NOT NULL,
    json TEXT NOT NULL,
    checksum INTEGER NOT NULL
) STRICT;

CREATE TABLE request (
    number INTEGER PRIMARY KEY,
    rod TEXT NOT NULL,
    what TEXT NOT NULL,
    alarm TEXT,
    reason TEXT,
    asked TEXT NOT NULL,
    applied INTEGER NOT NULL,
    checksum INTEGER NOT NULL
) STRICT;
CREATE INDEX request_waiting ON request (rod, number) WHERE applied = 0;

CREATE TABLE source (
    name TEXT PRIMARY KEY,
    bytes INTEGER NOT NULL,
    records INTEGER NOT NULL,
    checksum INTEGER NOT NULL
) STRICT;
";

#[cfg(test)]
mod tests {
    use super::*;

    /// Stores of format 1 exist in the field: their tables must not change, and any change is a new step.
    #[test]
    fn the_first_format_is_what_it_was() {
        let mut connection = Connection::open_in_memory().unwrap();
        let transaction = connection.transaction().unwrap();
        first(&transaction).unwrap();
        transaction.commit().unwrap();
        let definitions = definitions(&connection).unwrap();
        let text: String = definitions
            .iter()
            .flat_map(|(_, sql)| sql.split_whitespace())
            .collect::<Vec<_>>()
            .join(" ");
        assert_eq!(
            format!("{:08x}", crc32fast::hash(text.as_bytes())),
            "b2270fc8",
            "{text}"
        );
    }

    #[test]
    fn every_table_is_listed() {
        let mut connection = Connection::open_in_memory().unwrap();
        migrate(&mut connection, 0).unwrap();
        let mut statement = connection
            .prepare("SELECT name FROM sqlite_schema WHERE type = 'table' ORDER BY name")
            .unwrap();
        let found: Vec<String> = statement
            .query_map((), |row| row.get(0))
            .unwrap()
            .collect::<rusqlite::Result<_>>()
            .unwrap();
        let mut listed = TABLES.to_vec();
        listed.sort_unstable();
        assert_eq!(found, listed);
    }
}
