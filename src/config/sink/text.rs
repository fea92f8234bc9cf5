//! Checks of the texts of a `[[sink]]`: URL, header, mail address, topic.

use super::super::value::{Value, quoted};
use super::Kind;
use crate::config::settings::alert::TOPIC_PLACES;
use lettre::message::Mailbox;
use std::net::IpAddr;
use ureq::http::{HeaderName, HeaderValue, Uri};

impl Kind {
    /// Schemes of its `url`: the word, the default port, and true if the traffic can be read on the way.
    pub(super) fn schemes(self) -> &'static [(&'static str, u16, bool)] {
        match self {
            Self::Webhook | Self::Alertmanager => &[("http", 80, true), ("https", 443, false)],
            Self::Mqtt => &[("mqtt", 1883, true), ("mqtts", 8883, false)],
            Self::Email => &[
                ("smtp", 25, true),
                ("smtp+starttls", 587, false),
                ("smtps", 465, false),
            ],
        }
    }
}

/// Address of a server, from a `url`.
pub(super) struct Address {
    pub(super) url: String,
    pub(super) scheme: &'static str,
    pub(super) host: String,
    pub(super) port: u16,
    /// True if the traffic can be read on the way: not encrypted, and not on this machine.
    pub(super) is_open: bool,
}

/// Reads a header, name and value; headers for secrets are a fault.
pub(super) fn header(value: &Value<'_>) -> Option<(String, String)> {
    let text = value.name_string()?;
    let parts = text
        .split_once(':')
        .map(|(name, value)| (name.trim(), value.trim()));
    let is_header = |(name, value): &(&str, &str)| {
        HeaderName::from_bytes(name.as_bytes()).is_ok() && HeaderValue::from_str(value).is_ok()
    };
    let Some((name, content)) = parts.filter(is_header) else {
        value.fault(format!(
            "\"{text}\" is no header, write it like \"X-Site: Duomo\""
        ));
        return None;
    };
    if name.eq_ignore_ascii_case("authorization") {
        value.fault("a secret does not belong into the configuration: name a `token_file`");
        return None;
    }
    Some((name.to_owned(), content.to_owned()))
}

/// Reads a mail address, perhaps with a name.
pub(super) fn mailbox(value: &Value<'_>) -> Option<Mailbox> {
    let text = value.name_string()?;
    let mailbox = text.parse::<Mailbox>().ok();
    if mailbox.is_none() {
        value.fault(format!(
            "\"{text}\" is no address, write it like \"tie-rods@example.org\" or \"Duomo <tie-rods@example.org>\""
        ));
    }
    mailbox
}

/// Reads a topic with names in braces.
pub(super) fn topic(value: &Value<'_>) -> Option<String> {
    let text = value.name_string()?;
    let rest = TOPIC_PLACES
        .iter()
        .fold(text.to_owned(), |rest, place| rest.replace(place, ""));
    let is_topic = !rest.contains(['{', '}', '#', '+']) && !text.starts_with('$');
    if !is_topic {
        value.fault(format!(
            "\"{text}\" is no topic: no '#', no '+', no '$' at its beginning, and in braces only {}",
            TOPIC_PLACES.join(", ")
        ));
    }
    is_topic.then(|| text.to_owned())
}

/// Reads the address of a server, by a scheme of its kind of sink.
pub(super) fn address(value: &Value<'_>, kind: Kind, schemes: &[String]) -> Option<Address> {
    let text = value.name_string()?;
    let refuse = |why: String| {
        value.fault(why);
        None
    };
    let Ok(uri) = text.parse::<Uri>() else {
        return refuse(format!("\"{text}\" is no URL"));
    };
    let known = kind.schemes().iter().find(|(word, ..)| {
        uri.scheme_str()
            .is_some_and(|scheme| scheme.eq_ignore_ascii_case(word))
    });
    let (Some((scheme, port, is_plain)), Some(authority)) = (known, uri.authority()) else {
        let words: Vec<&str> = schemes.iter().map(String::as_str).collect();
        return refuse(format!("\"{text}\" does not begin with {}", quoted(&words)));
    };
    if authority.as_str().contains('@') {
        return refuse("holds a user: user and password stand in keys of their own".to_owned());
    }
    let host = authority.host().trim_matches(['[', ']']).to_owned();
    if host.is_empty() {
        return refuse(format!("\"{text}\" names no host"));
    }
    let has_port = authority.as_str().len() > authority.host().len();
    let port = match authority.port_u16() {
        Some(port) if port > 0 => port,
        None if !has_port => *port,
        _ => return refuse(format!("\"{text}\" has no port from 1 to 65535")),
    };
    let is_http = matches!(kind, Kind::Webhook | Kind::Alertmanager);
    if !is_http && !matches!(uri.path(), "" | "/") || kind != Kind::Webhook && uri.query().is_some() {
        return refuse(format!("\"{text}\" holds more than a server"));
    }
    let is_here = host.eq_ignore_ascii_case("localhost")
        || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback());
    if kind == Kind::Email && *is_plain && !is_here {
        return refuse(format!(
            "\"{text}\" is not encrypted and not on this machine: use smtp+starttls:// or smtps://"
        ));
    }
    Some(Address {
        url: text.to_owned(),
        scheme,
        host,
        port,
        is_open: *is_plain && !is_here,
    })
}
