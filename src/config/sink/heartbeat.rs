//! `[alert]`: messages about the daemon itself, and its heartbeat.

use super::text::address;
use super::{Kind, check_secrets};
use crate::config::list::{file, list, strings};
use crate::config::range::{Range, toml_string};
use crate::config::reader::{Absent, Table, key};
use crate::config::settings::alert::{AlertSettings, HeartbeatSettings, HttpTarget, SinkSettings};

const MINUTE_S: f64 = 60.0;

/// Reads the section; `sinks` are those of the site.
pub(in crate::config) fn read(table: &mut Table<'_>, sinks: Option<&[SinkSettings]>) -> AlertSettings {
    let default = AlertSettings::default();
    let settle_s = table.number(
        key(
            "settle_s",
            "a condition of the daemon (full disk, dead sink, bad reload) that lasts less is not told to the sinks, nor is so short a pause of it [s]",
        ),
        Range::within(0.0, 86_400.0),
        default.settle_s,
    );
    let mail = table.take(
        key(
            "daily",
            "sinks that are told once a day that the daemon is at work, and what lasts",
        ),
        "a list of ids of [[sink]], at most 100",
        Absent::Default(Vec::new()),
        |value| {
            list(value, |id| {
                let name = id.name_string()?;
                let is_known = sinks.is_none_or(|sinks| sinks.iter().any(|sink| sink.id == name));
                if !is_known {
                    id.fault(format!("there is no [[sink]] with id \"{name}\""));
                }
                is_known.then(|| name.to_owned())
            })
        },
        |ids| strings(ids.iter().cloned()),
    );
    let daily_h = table.number(
        key("daily_h", "hour of the day at which they are told, UTC [h]"),
        Range::within(0.0, 23.99),
        default.daily_h,
    );
    let heartbeat = table.optional_section(
        "heartbeat",
        "A sign of life to a dead-man switch: its silence is the alarm.",
        heartbeat,
    );
    AlertSettings {
        settle_s,
        daily: mail.unwrap_or_default(),
        daily_h,
        heartbeat: heartbeat.flatten(),
    }
}

fn heartbeat(table: &mut Table<'_>) -> Option<HeartbeatSettings> {
    let schemes = ["http://".to_owned(), "https://".to_owned()];
    let address = table.take(
        key(
            "url",
            "the switch; JSON is posted there while the daemon is at work and results are kept",
        ),
        "one server, http(s)://…, without user and password",
        Absent::Required,
        |value| address(value, Kind::Webhook, &schemes),
        |address| toml_string(&address.url),
    );
    let every_s = MINUTE_S
        * table.number(
            key("every_min", "time from one sign to the next [min]"),
            Range::within(0.01, 1440.0),
            5.0,
        );
    let token_file = file(
        table,
        key(
            "token_file",
            "file with a bearer token; may begin with $CREDENTIALS_DIRECTORY/",
        ),
        "no token is sent",
    );
    let ca_file = file(
        table,
        key(
            "ca_file",
            "file with the certificates (PEM) that are trusted; may begin with $CREDENTIALS_DIRECTORY/",
        ),
        "the public roots of the web are trusted",
    );
    let address = address?;
    check_secrets(table, &address, token_file.is_some(), false);
    Some(HeartbeatSettings {
        target: HttpTarget {
            url: address.url,
            token_file,
            ca_file,
        },
        every_s,
    })
}
