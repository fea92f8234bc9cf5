//! `[http]`: the daemon's HTTP server.

use super::list::{file, list, strings};
use super::range::toml_string;
use super::reader::{Absent, Table, key};
use super::settings::http::{self, HttpSettings};
use super::value::Value;
use std::net::SocketAddr;

/// Reads the section.
pub(super) fn read(table: &mut Table<'_>) -> HttpSettings {
    let default = HttpSettings::default();
    let listen = table.take(
        key(
            "listen",
            "address and port of the page, health, readiness and metrics; port 0 takes a free one; reading needs no password",
        ),
        "\"address:port\" like \"127.0.0.1:7416\" or \"[::1]:7416\", or \"off\"",
        Absent::Default(default.listen),
        |value| {
            let text = value.string()?;
            if text == "off" {
                return Some(None);
            }
            let address = text.parse::<SocketAddr>().ok();
            if address.is_none() {
                value.fault(format!(
                    "{} is no address with a port, write it like \"127.0.0.1:7416\", or \"off\"",
                    toml_string(text)
                ));
            }
            address.map(Some)
        },
        |listen| match listen {
            Some(address) => toml_string(&address.to_string()),
            None => toml_string("off"),
        },
    );
    let allow_remote = table
        .take(
            key(
                "allow_remote",
                "whether it may listen where other machines reach it, who then read everything it shows",
            ),
            "true or false",
            Absent::Default(false),
            |value| value.boolean(),
            bool::to_string,
        )
        .unwrap_or(false);
    let listen = listen.unwrap_or(default.listen);
    if let Some(address) = listen
        && !address.ip().to_canonical().is_loopback()
        && !allow_remote
    {
        table.fault_of(
            "listen",
            format!(
                "other machines reach {address}: take 127.0.0.1 and a proxy that asks for a password, or say allow_remote = \
                 true"
            ),
        );
    }
    let token_file = file(
        table,
        key(
            "token_file",
            "file with the token (one line, 16 characters or more) of those who acknowledge alarms on the page; may begin with \
             $CREDENTIALS_DIRECTORY/; read at the start",
        ),
        "nobody may acknowledge over HTTP",
    );
    let names = table.take(
        key(
            "names",
            "host names browsers reach the page under, besides addresses and localhost",
        ),
        "a list of at most 100 names",
        Absent::Default(Vec::new()),
        |value| list(value, |name| name.name_string().map(str::to_owned)),
        |names| strings(names.iter().cloned()),
    );
    let viewer_origins = table.take(
        key(
            "viewer_origins",
            "origins of pages that may open the live view at /viewer, besides programs that are no browser: \"file://\" for viewers on \
             the desktop (and any page opened from a file), \"https://app.foxglove.dev\"",
        ),
        "a list of at most 100 origins",
        Absent::Default(default.viewer_origins),
        |value| list(value, origin),
        |origins| strings(origins.iter().cloned()),
    );
    HttpSettings {
        listen,
        token_file,
        names: names.unwrap_or_default(),
        viewer_origins: viewer_origins.unwrap_or_default(),
    }
}

fn origin(value: &Value<'_>) -> Option<String> {
    let text = value.string()?;
    match http::origin(text) {
        Ok(origin) => Some(origin),
        Err(why) => {
            value.fault(format!("{} is {why}", toml_string(text)));
            None
        }
    }
}
