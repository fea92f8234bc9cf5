//! One HTTP request: JSON posted, answered within a deadline, judged by its status.

use super::Failure;
use crate::analysis::signal::record::Timestamp;
use crate::config::settings::alert::HttpTarget;
use crate::config::settings::credential::CredentialPath;
use crate::site::clock;
use std::io::Read;
use std::time::Duration;
use ureq::http::Response;
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};
use ureq::{Agent, Body};

/// Most bytes of an answer shown.
const SHOWN: u64 = 200;

/// Posts `json` to `url` of `target`. Every request has a connection of its own: alarms are rare, and a connection that
/// is not kept cannot be half dead.
pub(super) fn post(
    target: &HttpTarget,
    url: &str,
    headers: &[(&str, &str)],
    json: &str,
    deadline: Duration,
) -> Result<(), Failure> {
    let roots = match &target.ca_file {
        Some(file) => trusted(file)?,
        None => RootCerts::WebPki,
    };
    let agent: Agent = Agent::config_builder()
        .timeout_global(Some(deadline))
        .http_status_as_error(false)
        .max_redirects(0)
        .max_idle_connections(0)
        .proxy(None)
        .user_agent(concat!("tirante/", env!("CARGO_PKG_VERSION")))
        .tls_config(TlsConfig::builder().root_certs(roots).build())
        .build()
        .into();
    let mut request = agent.post(url).header("Content-Type", "application/json");
    if let Some(file) = &target.token_file {
        request = request.header("Authorization", format!("Bearer {}", file.read_line()?));
    }
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    match request.send(json) {
        Ok(response) => judge(&origin(url), response),
        Err(ureq::Error::Timeout(_)) => Err(Failure::new(format!(
            "{}: no answer within {:.0} s",
            origin(url),
            deadline.as_secs_f64()
        ))),
        Err(error) => {
            let error = error.to_string().replace(url, &origin(url));
            Err(Failure::new(format!("{}: {error}", origin(url))))
        }
    }
}

/// Scheme, host and port of an address. A fault is told to everybody, in the log, on the page and through the other sinks;
/// path and query of a webhook or a ping are often the secret that lets one post there.
fn origin(url: &str) -> String {
    let (scheme, rest) = url.split_once("://").unwrap_or(("", url));
    let authority = rest.split(['/', '?', '#']).next().unwrap_or_default();
    let host = authority.rsplit('@').next().unwrap_or_default();
    if scheme.is_empty() {
        host.to_owned()
    } else {
        format!("{scheme}://{host}")
    }
}

fn judge(from: &str, response: Response<Body>) -> Result<(), Failure> {
    let status = response.status();
    if status.is_success() {
        return Ok(());
    }
    let retry_after = response
        .headers()
        .get("Retry-After")
        .filter(|_| matches!(status.as_u16(), 429 | 503))
        .and_then(|value| value.to_str().ok())
        .and_then(|text| wait(text, clock::now()));
    let mut reason = format!("{from} answers {status}");
    if let Some(place) = response.headers().get("Location").and_then(|l| l.to_str().ok()) {
        let place = if place.contains("://") {
            origin(place)
        } else {
            "another path".to_owned()
        };
        reason +=
            &format!(" to {place}, which is not followed: put the address it names into the configuration");
    }
    let mut text = Vec::new();
    // The answer is only shown, so the readable part is enough.
    let _ = response
        .into_body()
        .into_reader()
        .take(SHOWN)
        .read_to_end(&mut text);
    let text: String = String::from_utf8_lossy(&text)
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    if !text.trim().is_empty() {
        reason += &format!(" ({})", text.trim());
    }
    Err(Failure { reason, retry_after })
}

/// Wait asked for by `Retry-After`: seconds, or until a date.
fn wait(text: &str, now: Timestamp) -> Option<Duration> {
    if let Ok(seconds) = text.trim().parse() {
        return Some(Duration::from_secs(seconds));
    }
    let date = jiff::fmt::rfc2822::DateTimeParser::new()
        .parse_timestamp(text.trim())
        .ok()?;
    let nanos = i64::try_from(date.as_nanosecond()).ok()?;
    let wait_s = Timestamp::from_nanos(nanos).seconds_since(now);
    Some(Duration::try_from_secs_f64(wait_s).unwrap_or_default())
}

/// Reads the certificates of a file.
fn trusted(file: &CredentialPath) -> Result<RootCerts, Failure> {
    let bytes = file.read()?;
    let mut certificates = Vec::new();
    for item in parse_pem(&bytes) {
        match item {
            Ok(PemItem::Certificate(certificate)) => certificates.push(certificate),
            Ok(_) => {}
            Err(error) => return Err(Failure::new(format!("{}: {error}", file.as_str()))),
        }
    }
    if certificates.is_empty() {
        return Err(Failure::new(format!(
            "{} holds no certificate (PEM)",
            file.as_str()
        )));
    }
    Ok(RootCerts::from(certificates))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_tells_no_secret_of_an_address() {
        for (url, told) in [
            (
                "https://hooks.slack.com/services/T0/B0/secret",
                "https://hooks.slack.com",
            ),
            ("http://host:8080?secret=abc", "http://host:8080"),
            ("https://me:secret@[::1]:8/x#secret", "https://[::1]:8"),
        ] {
            assert_eq!(origin(url), told);
        }
    }

    #[test]
    fn retry_after_is_seconds_or_a_date() {
        let now = Timestamp::from_nanos(784_111_777_000_000_000);
        assert_eq!(wait(" 120 ", now), Some(Duration::from_secs(120)));
        let date = |text| wait(text, now);
        assert_eq!(
            date("Sun, 06 Nov 1994 08:50:37 GMT"),
            Some(Duration::from_secs(60))
        );
        assert_eq!(date("Sun, 06 Nov 1994 08:48:37 GMT"), Some(Duration::ZERO));
        assert_eq!(date("soon"), None);
        assert_eq!(date("-5"), None);
    }
}
