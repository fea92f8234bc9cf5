//! `[forward]`: the copy of the results to a centre of many sites.

use super::list::file;
use super::range::{Range, toml_string};
use super::reader::{Absent, Table, key};
use super::value::Value;
use crate::analysis::signal::record::time::DAY_S;
use crate::config::settings::forward::{ForwardSettings, LONGEST_SITE, NatsSettings, is_site};
use crate::config::settings::store::StoreSettings;
use std::net::IpAddr;
use std::time::Duration;

/// Default port of NATS.
const PORT: u16 = 4222;
/// Least age of results when they leave the store \[s\].
const KEEP_S: f64 = 30.0 * DAY_S;

/// Reads the section; `store` is that of the site.
pub(super) fn read(table: &mut Table<'_>, store: &StoreSettings) -> Option<ForwardSettings> {
    let nats = nats(table, "to");
    let site = table.take(
        key("site", "name of the site at the centre, as in its list"),
        format!("1 to {LONGEST_SITE} letters, digits, '-', '_'"),
        Absent::Required,
        site,
        |site| toml_string(site),
    );
    let heartbeat_s = table.number(
        key(
            "heartbeat_s",
            "interval at which the centre is told that the daemon lives, and how it stands [s]",
        ),
        Range::within(1.0, 3600.0),
        60.0,
    );
    let command_key = table.take(
        key(
            "command_key",
            "public key of those who may command this site from the centre, as `tirante hub key --commands` prints it",
        ),
        "O and 55 letters and digits",
        Absent::Nothing("commands of the centre are not asked for"),
        command_key,
        |key| toml_string(key),
    );
    if store.keep_lines_s.is_some_and(|lines_s| lines_s < KEEP_S) {
        table.fault_of(
            "to",
            "[store] keep_lines_d is below 30: what the post loses is sent again from the store",
        );
    }
    Some(ForwardSettings {
        nats: nats?,
        site: site?,
        command_key,
        heartbeat: Duration::from_secs_f64(heartbeat_s),
    })
}

/// Reads the keys of a connection to NATS; `address` is the name of its first.
pub(super) fn nats(table: &mut Table<'_>, address: &'static str) -> Option<NatsSettings> {
    let post = table.take(
        key(
            address,
            "the NATS server: nats+tls://host:port, or nats://127.0.0.1:port on this machine; the servers of a cluster separated by commas",
        ),
        "servers of one cluster, without user and password",
        Absent::Required,
        post,
        |post: &NatsSettings| toml_string(&post.url()),
    );
    let credentials = file(
        table,
        key(
            "credentials",
            "file with an NKEY seed or a .creds file, readable by its owner alone; may begin with $CREDENTIALS_DIRECTORY/",
        ),
        "no login",
    );
    let is_tls = post.as_ref().is_none_or(|post| post.is_tls);
    let ca = file(
        table,
        key(
            "ca",
            "file with the certificates (PEM) that are trusted besides the machine's own",
        )
        .only(is_tls, "nats+tls://"),
        "the machine's own are trusted",
    );
    if is_tls && credentials.is_none() && post.is_some() {
        table.absence_of("credentials", "file with the site's own NKEY seed");
    }
    Some(NatsSettings {
        credentials,
        ca,
        ..post?
    })
}

/// Reads the name of a site.
pub(super) fn site(value: &Value<'_>) -> Option<String> {
    let text = value.string()?;
    if !is_site(text) {
        value.fault(format!(
            "\"{text}\" is no name of a site: 1 to {LONGEST_SITE} letters, digits, '-', '_', and neither HUB nor WORK, which are the hub's and the workers'"
        ));
        return None;
    }
    Some(text.to_owned())
}

/// Reads a public key of commands, which is an operator's NKEY: no login is one.
fn command_key(value: &Value<'_>) -> Option<String> {
    let text = value.string()?;
    let pair = nkeys::KeyPair::from_public_key(text).ok();
    if pair.is_none_or(|pair| pair.key_pair_type() != nkeys::KeyPairType::Operator) {
        value.fault("is no public key of commands: `tirante hub key --commands FILE` prints one, O…");
        return None;
    }
    Some(text.to_owned())
}

/// Reads the addresses of one cluster; they are all encrypted, or none.
fn post(value: &Value<'_>) -> Option<NatsSettings> {
    let text = value.name_string()?;
    let refuse = |why: String| {
        value.fault(why);
        None
    };
    let mut servers = Vec::new();
    let mut are_tls = Vec::new();
    for address in text.split(',').map(str::trim) {
        match place(address) {
            Ok((host, port, is_tls)) => {
                servers.push((host, port));
                are_tls.push(is_tls);
            }
            Err(why) => return refuse(format!("{address} {why}")),
        }
    }
    if are_tls.iter().any(|is_tls| *is_tls != are_tls[0]) {
        return refuse(format!("{text} mixes nats+tls:// and nats://"));
    }
    Some(NatsSettings {
        servers,
        is_tls: are_tls[0],
        credentials: None,
        ca: None,
    })
}

/// Host, port, and true for encryption, of an address; or the reason why it is none.
fn place(text: &str) -> Result<(String, u16, bool), &'static str> {
    const NONE: &str = "is no NATS server: write nats+tls://broker.example:4222";
    let (rest, is_tls) = match (text.strip_prefix("nats+tls://"), text.strip_prefix("nats://")) {
        (Some(rest), _) => (rest, true),
        (None, Some(rest)) => (rest, false),
        (None, None) => return Err(NONE),
    };
    let rest = rest.trim_end_matches('/');
    if rest.contains('@') {
        return Err("holds a password: name a file as `credentials`");
    }
    let (host, port) = match rest.rsplit_once(':') {
        Some((host, port)) if !host.ends_with(':') && !port.ends_with(']') => {
            (host, port.parse().map_err(|_| "has no port from 1 to 65535")?)
        }
        _ => (rest, PORT),
    };
    if host.is_empty() || host.contains(['/', '?', '#', ' ']) || port == 0 {
        return Err(NONE);
    }
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    let is_here = host == "localhost" || bare.parse::<IpAddr>().is_ok_and(|address| address.is_loopback());
    if !is_tls && !is_here {
        return Err("is another machine: only nats+tls:// goes there");
    }
    Ok((host.to_owned(), port, is_tls))
}
