//! `[ingest]`: sources of live data.

use super::range::{Range, toml_string};
use super::reader::{Absent, Key, Table, key};
use super::value::Value;
use crate::config::settings::ingest::{BoundCertificate, IngestSettings, Listen, TlsSettings};
use std::collections::BTreeSet;
use std::path::PathBuf;

/// Most listening sockets.
const MOST_SOCKETS: usize = 16;

/// Most sender names or topics of one certificate.
const MOST_BOUND: usize = 100;

const HOUR_S: f64 = 3600.0;

/// Reads the section.
pub(super) fn read(table: &mut Table<'_>) -> IngestSettings {
    let default = IngestSettings::default();
    let folder = path(
        table,
        key(
            "folder",
            "folder that is watched for recordings; relative to the working folder",
        ),
        Absent::Nothing("no folder is watched"),
    );
    let subfolders = table
        .take(
            key(
                "subfolders",
                "whether the folders below it are watched too; links are never followed",
            ),
            "true or false",
            Absent::Default(default.subfolders),
            |value| value.boolean(),
            bool::to_string,
        )
        .unwrap_or(default.subfolders);
    let settle_s = table.number(
        key(
            "settle_s",
            "a recording without an end that has not grown for this long counts as cut short [s]",
        ),
        Range::within(1.0, 86_400.0),
        default.settle_s,
    );
    let join_s = table.number(
        key(
            "join_s",
            "open samples at the end of a recording in the folder wait this long for one that goes on there; then their record ends [s]",
        ),
        Range::within(0.0, 86_400.0),
        default.join_s,
    );
    let listen = table
        .take(
            key(
                "listen",
                "sockets that speak MCAP and JSON lines, `tcp://ADDRESS:PORT` and `unix://PATH`",
            ),
            format!("up to {MOST_SOCKETS} of them"),
            Absent::Default(default.listen),
            sockets,
            |sockets| {
                let sockets: Vec<String> = sockets
                    .iter()
                    .map(|socket| toml_string(&socket.to_string()))
                    .collect();
                format!("[{}]", sockets.join(", "))
            },
        )
        .unwrap_or_default();
    let clients = table.integer(
        key("clients", "most clients at once"),
        1,
        1024,
        default.clients as u64,
    );
    let idle_s = table.number(
        key(
            "idle_s",
            "a client of which no whole record or line came for this long is closed [s]",
        ),
        Range::within(1.0, 86_400.0),
        default.idle_s,
    );
    let resume_s = HOUR_S
        * table.number(
            key("resume_h", "a named sender that was cut off may take up its stream for this long; then its last record ends [h]"),
            Range::within(0.01, 744.0),
            default.resume_s / HOUR_S,
        );
    let tls = table.optional_section(
        "tls",
        "TLS on every TCP socket; only clients with a certificate of the authority come in.",
        tls,
    );
    if let (Some(open), None) = (listen.iter().find(|socket| socket.is_open()), &tls) {
        table.fault_of(
            "listen",
            format!("{open} is not on loopback: [ingest.tls] is needed, with certificate, key and client_ca"),
        );
    }
    IngestSettings {
        folder,
        subfolders,
        settle_s,
        join_s,
        readings_s: default.readings_s,
        listen,
        tls: tls.flatten(),
        clients: clients as usize,
        idle_s,
        resume_s,
    }
}

fn tls(table: &mut Table<'_>) -> Option<TlsSettings> {
    let certificate = path(
        table,
        key(
            "certificate",
            "the daemon's certificate and those between it and its authority (PEM file)",
        ),
        Absent::Required,
    );
    let private = path(
        table,
        key("key", "the daemon's private key (PEM file)"),
        Absent::Required,
    );
    let client_ca = path(
        table,
        key(
            "client_ca",
            "the authority that clients' certificates must come from (PEM file)",
        ),
        Absent::Required,
    );
    let mut names = BTreeSet::new();
    let bound = table.list(
        "bound",
        "Clients' certificates with what their holders may send; with one entry, certificates without an entry are refused.",
        |table| bound(table, &mut names),
    );
    Some(TlsSettings {
        certificate: certificate?,
        key: private?,
        client_ca: client_ca?,
        bound: bound.into_iter().collect::<Option<_>>()?,
    })
}

fn bound(table: &mut Table<'_>, names: &mut BTreeSet<String>) -> Option<BoundCertificate> {
    let certificate = table.take(
        key(
            "certificate",
            "the certificate's common name, or one of its DNS names",
        ),
        "1 to 255 bytes of text",
        Absent::Required,
        |value| value.name_string().map(str::to_owned),
        |name| toml_string(name),
    );
    let senders = texts(
        table,
        key("senders", "names under which its holder may send"),
        Absent::Nothing("the certificate's name"),
    );
    let topics = texts(
        table,
        key(
            "topics",
            "topics on which its holder may send; a `*` at the end stands for anything",
        ),
        Absent::Default(vec!["*".to_owned()]),
    );
    let certificate = certificate?;
    if !names.insert(certificate.clone()) {
        table.fault_of("certificate", format!("{certificate} stands twice"));
        return None;
    }
    Some(BoundCertificate {
        senders: senders.unwrap_or_else(|| vec![certificate.clone()]),
        topics: topics?,
        certificate,
    })
}

/// Takes a list of texts.
fn texts(table: &mut Table<'_>, key: Key, absent: Absent<Vec<String>>) -> Option<Vec<String>> {
    table.take(
        key,
        format!("up to {MOST_BOUND} texts of 1 to 255 bytes"),
        absent,
        |value| {
            let elements = value.array()?;
            if elements.len() > MOST_BOUND {
                value.fault(format!(
                    "has {} entries, at most {MOST_BOUND} are allowed",
                    elements.len()
                ));
                return None;
            }
            let texts = elements
                .iter()
                .map(|element| element.name_string().map(str::to_owned));
            texts.collect()
        },
        |texts| {
            let texts: Vec<String> = texts.iter().map(|text| toml_string(text)).collect();
            format!("[{}]", texts.join(", "))
        },
    )
}

fn path(table: &mut Table<'_>, key: Key, absent: Absent<String>) -> Option<PathBuf> {
    table
        .take(
            key,
            "1 to 255 bytes of text",
            absent,
            |value| value.name_string().map(str::to_owned),
            |path| toml_string(path),
        )
        .map(PathBuf::from)
}

fn sockets(value: &Value<'_>) -> Option<Vec<Listen>> {
    let elements = value.array()?;
    if elements.len() > MOST_SOCKETS {
        value.fault(format!(
            "has {} entries, at most {MOST_SOCKETS} are allowed",
            elements.len()
        ));
        return None;
    }
    let mut sockets: Vec<Listen> = Vec::new();
    let mut is_good = true;
    for element in &elements {
        let Some(text) = element.name_string() else {
            is_good = false;
            continue;
        };
        match text.parse() {
            Ok(socket) if !sockets.contains(&socket) => {
                sockets.push(socket);
                continue;
            }
            Ok(socket) => element.fault(format!("{socket} stands twice")),
            Err(what) => element.fault(format!("{text} {what}")),
        }
        is_good = false;
    }
    is_good.then_some(sockets)
}
