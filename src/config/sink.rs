//! `[[sink]]`: destinations of alarms.

pub(super) mod heartbeat;
mod text;

use super::RodConfig;
use super::list::{file, list, strings};
use super::range::{Range, toml_string};
use super::reader::{Absent, Table, key};
use super::value::{Value, quoted};
use crate::analysis::signal::record::RodId;
use crate::analysis::track::Kind as AlarmKind;
use crate::config::settings::alert::{
    AlertmanagerSettings, EmailSettings, HttpTarget, LOG, Login, MailSecurity, MqttSettings, SinkKind,
    SinkSettings, WebhookSettings,
};
use lettre::message::Mailbox;
use std::collections::BTreeSet;
use text::{Address, address, header, mailbox, topic};

/// Words allowed for `kind`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Webhook,
    Alertmanager,
    Mqtt,
    Email,
}

const KINDS: [(&str, Kind); 4] = [
    ("webhook", Kind::Webhook),
    ("alertmanager", Kind::Alertmanager),
    ("mqtt", Kind::Mqtt),
    ("email", Kind::Email),
];

/// Whose alarms the sinks are told.
#[derive(Debug, Clone, Copy)]
pub(super) enum Whose<'c> {
    /// Those of a site with these rods.
    Site(&'c [Option<RodConfig>]),
    /// Those of a centre with these sites.
    Centre(&'c BTreeSet<String>),
}

/// Reads all sinks; their filters name rods, at a centre sites.
pub(super) fn read_all(root: &mut Table<'_>, whose: Whose<'_>) -> Option<Vec<SinkSettings>> {
    let mut ids: Vec<(String, usize)> = Vec::new();
    let sinks = root.list(
        "sink",
        "Where alarms go; the log is always told (`run`).",
        |table| {
            let sink = read(table, whose);
            let line = table.line_of("id");
            if let Some(SinkSettings { id, .. }) = &sink {
                match ids.iter().find(|(other, _)| other.eq_ignore_ascii_case(id)) {
                    Some((_, first)) => {
                        table.fault_of(
                            "id",
                            format!("\"{id}\" is the id of the sink in line {first} too"),
                        );
                    }
                    None if id.eq_ignore_ascii_case(LOG) => {
                        table.fault_of(
                            "id",
                            "\"log\" is the id of the program's log, which is always told",
                        );
                    }
                    None => ids.push((id.clone(), line)),
                }
            }
            sink
        },
    );
    sinks.into_iter().collect()
}

fn read(table: &mut Table<'_>, whose: Whose<'_>) -> Option<SinkSettings> {
    let id = table.take(
        key(
            "id",
            "name of the sink, unique within the site; under another id it is a new sink",
        ),
        "1 to 64 letters, digits, '-', '_', '.'; not starting with '.'",
        Absent::Required,
        super::rod::id,
        |id| toml_string(id),
    );
    let words: Vec<&str> = KINDS.iter().map(|(word, _)| *word).collect();
    let kind = table.take(
        key("kind", "what it is"),
        quoted(&words),
        Absent::Required,
        |value| value.choice(&KINDS),
        |kind| toml_string(KINDS.iter().find(|(_, k)| k == kind).map_or("", |(word, _)| word)),
    );
    let Some(kind) = kind else {
        table.ignore(&[
            "url",
            "kinds",
            "rods",
            "sites",
            "token_file",
            "headers",
            "resend_s",
            "topic",
            "retain",
            "status_topic",
            "from",
            "to",
            "group_s",
            "user",
            "password_file",
            "ca_file",
        ]);
        return None;
    };
    let schemes: Vec<String> = kind
        .schemes()
        .iter()
        .map(|(word, ..)| format!("{word}://"))
        .collect();
    let address = table.take(
        key(
            "url",
            "the server: http(s)://…, mqtt(s)://host:port, smtp(s)://host:port or smtp+starttls://host:port",
        ),
        "one server, without user and password; smtp:// on this machine only",
        Absent::Required,
        |value| address(value, kind, &schemes),
        |address| toml_string(&address.url),
    );
    let kinds = filter(table, "kinds", "kinds of alarms it wants", alarm_kind);
    let (rods, sites) = match whose {
        Whose::Site(known) => (
            filter(table, "rods", "rods whose alarms it wants", |value| {
                rod(value, known)
            }),
            Some(Vec::new()),
        ),
        Whose::Centre(known) => (
            Some(Vec::new()),
            filter(
                table,
                "sites",
                "sites whose alarms and conditions it wants",
                |value| site(value, known),
            ),
        ),
    };
    let is_http = matches!(kind, Kind::Webhook | Kind::Alertmanager);
    let token_file = file(
        table,
        key(
            "token_file",
            "file with a bearer token; may begin with $CREDENTIALS_DIRECTORY/",
        )
        .only(is_http, "kind = \"webhook\" or \"alertmanager\""),
        "no token is sent",
    );
    let headers = table.take(
        key("headers", "further headers, each \"Name: value\"")
            .only(kind == Kind::Webhook, "kind = \"webhook\""),
        "a list of at most 100 headers",
        Absent::Default(Vec::new()),
        |value| list(value, header),
        |headers| strings(headers.iter().map(|(name, value)| format!("{name}: {value}"))),
    );
    let resend_s = table.take(
        key(
            "resend_s",
            "time after which everything that stands is sent again; an alert not sent for 300 s ends [s]",
        )
        .only(kind == Kind::Alertmanager, "kind = \"alertmanager\""),
        RESEND_S.of("resend_s"),
        Absent::Default(60.0),
        |value| value.number(RESEND_S),
        |number| super::range::toml_float(*number),
    );
    let group_s = table.take(
        key(
            "group_s",
            "alarms of so long a time go into one mail; 0: each has its own [s]",
        )
        .only(kind == Kind::Email, "kind = \"email\""),
        GROUP_S.of("group_s"),
        Absent::Default(60.0),
        |value| value.number(GROUP_S),
        |number| super::range::toml_float(*number),
    );
    let topic = table.take(
        key(
            "topic",
            "topic of a message, with {site}, {rod}, {kind}, {what} and {alarm} in it",
        )
        .only(kind == Kind::Mqtt, "kind = \"mqtt\""),
        "1 to 255 bytes of text without '#' and '+'",
        Absent::Default("tirante/{site}/{rod}/{kind}".to_owned()),
        topic,
        |topic| toml_string(topic),
    );
    let is_retained = table.take(
        key(
            "retain",
            "whether the broker keeps the latest message of each topic",
        )
        .only(kind == Kind::Mqtt, "kind = \"mqtt\""),
        quoted(&["yes", "no"]),
        Absent::Default(false),
        |value| value.choice(&[("yes", true), ("no", false)]),
        |is_retained| toml_string(if *is_retained { "yes" } else { "no" }),
    );
    let status_topic = table.take(
        key(
            "status_topic",
            "topic of the daemon's state, kept by the broker, which says \"gone\" there when the daemon dies (last will); {site} may \
             stand in it",
        )
        .only(kind == Kind::Mqtt, "kind = \"mqtt\""),
        "1 to 255 bytes of text without '#' and '+'",
        Absent::Nothing("the broker is told of alarms only"),
        text::topic,
        |topic| toml_string(topic),
    );
    let is_email = kind == Kind::Email;
    let from = table.take(
        key("from", "who the mail is from").only(is_email, "kind = \"email\""),
        "an address, or a name and <address>",
        Absent::Required,
        mailbox,
        |from| toml_string(&from.to_string()),
    );
    let to = table.take(
        key("to", "who the mail is for; a server that refuses one refuses all")
            .only(is_email, "kind = \"email\""),
        "a list of 1 to 100 addresses",
        Absent::Required,
        |value| {
            let to = list(value, mailbox)?;
            if to.is_empty() {
                value.fault("is empty, at least one address is wanted");
            }
            (!to.is_empty()).then_some(to)
        },
        |to| strings(to.iter().map(Mailbox::to_string)),
    );
    let login = login(table, matches!(kind, Kind::Mqtt | Kind::Email));
    let ca_file = file(
        table,
        key(
            "ca_file",
            "file with the certificates (PEM) that are trusted; may begin with $CREDENTIALS_DIRECTORY/",
        ),
        "the public roots of the web are trusted",
    );
    let (id, address, login) = (id?, address?, login?);
    check_secrets(table, &address, token_file.is_some(), login.is_some());
    let Address {
        url,
        scheme,
        host,
        port,
        ..
    } = address;
    let target = HttpTarget {
        url,
        token_file,
        ca_file: ca_file.clone(),
    };
    let kind = match kind {
        Kind::Webhook => SinkKind::Webhook(WebhookSettings {
            target,
            headers: headers?,
        }),
        Kind::Alertmanager => SinkKind::Alertmanager(AlertmanagerSettings {
            target,
            resend_s: resend_s?,
        }),
        Kind::Mqtt => SinkKind::Mqtt(MqttSettings {
            host,
            port,
            is_tls: scheme == "mqtts",
            topic: topic?,
            is_retained: is_retained?,
            status_topic,
            login,
            ca_file,
        }),
        Kind::Email => SinkKind::Email(EmailSettings {
            host,
            port,
            security: match scheme {
                "smtps" => MailSecurity::Tls,
                "smtp+starttls" => MailSecurity::StartTls,
                _ => MailSecurity::Plain,
            },
            from: from?,
            to: to?,
            group_s: group_s?,
            login,
            ca_file,
        }),
    };
    Some(SinkSettings {
        id,
        kind,
        kinds: kinds?,
        rods: rods?,
        sites: sites?,
    })
}

const GROUP_S: Range = Range::within(0.0, 3600.0);
const RESEND_S: Range = Range::within(1.0, 240.0);

/// Checks that no secret leaves this machine unencrypted, and that no certificate is named without effect.
fn check_secrets(table: &Table<'_>, address: &Address, has_token: bool, has_login: bool) {
    let Address { scheme, is_open, .. } = address;
    let why = format!("others could read it on the way: {scheme}:// is not encrypted");
    if *is_open && has_token {
        table.fault_of("token_file", why.clone());
    }
    if *is_open && has_login {
        table.fault_of("password_file", why);
    }
    if matches!(*scheme, "http" | "mqtt" | "smtp") && table.has("ca_file") {
        table.fault_of(
            "ca_file",
            format!("has no effect: {scheme}:// is not encrypted; remove it"),
        );
    }
}

/// Reads user and password file, both or neither; `None` for a fault.
fn login(table: &mut Table<'_>, is_wanted: bool) -> Option<Option<Login>> {
    let only = "kind = \"mqtt\" or \"email\"";
    let user = table.take(
        key("user", "user name").only(is_wanted, only),
        "1 to 255 bytes of text",
        Absent::Nothing("no login"),
        |value| value.name_string().map(str::to_owned),
        |user| toml_string(user),
    );
    let password_file = file(
        table,
        key(
            "password_file",
            "file with the password; may begin with $CREDENTIALS_DIRECTORY/",
        )
        .only(is_wanted, only),
        "no login",
    );
    match (user, password_file) {
        (Some(user), Some(password_file)) => Some(Some(Login { user, password_file })),
        (None, None) => Some(None),
        (Some(_), None) if !table.has("password_file") => {
            table.fault_of("user", "wants a `password_file` beside it");
            None
        }
        (None, Some(_)) if !table.has("user") => {
            table.fault_of("password_file", "wants a `user` beside it");
            None
        }
        _ => None,
    }
}

/// Reads a filter list; empty without one, which lets everything pass.
fn filter<T: std::fmt::Display>(
    table: &mut Table<'_>,
    name: &'static str,
    meaning: &'static str,
    read: impl Fn(&Value<'_>) -> Option<T>,
) -> Option<Vec<T>> {
    table.take(
        key(name, meaning),
        "a list of at most 100; all if it is empty",
        Absent::Default(Vec::new()),
        |value| list(value, read),
        |wanted| strings(wanted.iter().map(T::to_string)),
    )
}

fn alarm_kind(value: &Value<'_>) -> Option<AlarmKind> {
    value.choice(&AlarmKind::ALL.map(|kind| (kind.code(), kind)))
}

fn rod(value: &Value<'_>, rods: &[Option<RodConfig>]) -> Option<RodId> {
    let id = value.name_string()?;
    // A rod with a fault has no id to compare with.
    let is_known = rods
        .iter()
        .any(|rod| rod.as_ref().is_none_or(|rod| rod.analysis.rod.0 == id));
    if !is_known {
        value.fault(format!("there is no [[rod]] with id \"{id}\""));
    }
    is_known.then(|| RodId(id.to_owned()))
}

fn site(value: &Value<'_>, known: &BTreeSet<String>) -> Option<String> {
    let name = value.name_string()?;
    if !known.contains(name) {
        value.fault(format!("there is no [[site]] with name \"{name}\""));
        return None;
    }
    Some(name.to_owned())
}
