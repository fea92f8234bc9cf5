//! Errors of `[[sink]]`, with key and line.

use super::desk::{config_text, sinks};
use tirante::config::settings::alert::{MailSecurity, SinkKind};
use tirante::config::{Config, ConfigError};

/// The faults of one sink, without their places.
fn faults(sink: &str) -> Vec<String> {
    let text = config_text(&format!("[[sink]]\nid = \"a\"\n{sink}"));
    match Config::parse(&text, "test") {
        Ok(_) => Vec::new(),
        Err(ConfigError::Faults { faults, .. }) => faults
            .iter()
            .map(|fault| {
                assert!(fault.line > 1, "{fault}");
                format!("{}: {}", fault.key, fault.message)
            })
            .collect(),
        Err(error) => panic!("{error}"),
    }
}

#[test]
fn every_misuse_is_refused_by_its_key() {
    let mail = "from = \"a@b.org\"\nto = [\"c@d.org\"]\n";
    let login = "user = \"u\"\npassword_file = \"p\"\n";
    let cases = [
        ("kind = \"webhook\"\n", "sink[0].url: is missing"),
        ("kind = \"log\"\n", "sink[0].kind: \"log\" is not known"),
        (
            "kind = \"webhook\"\nurl = \"ftp://x\"\n",
            "sink[0].url: \"ftp://x\" does not begin with",
        ),
        (
            "kind = \"webhook\"\nurl = \"http://\"\n",
            "sink[0].url: \"http://\" is no URL",
        ),
        (
            "kind = \"webhook\"\nurl = \"http://u:p@x/\"\n",
            "sink[0].url: holds a user",
        ),
        (
            "kind = \"webhook\"\nurl = \"http://x:99999/\"\n",
            "has no port from 1 to 65535",
        ),
        (
            "kind = \"webhook\"\nurl = \"http://x:0/\"\n",
            "has no port from 1 to 65535",
        ),
        (
            "kind = \"alertmanager\"\nurl = \"http://x/?a=b\"\n",
            "holds more than a server",
        ),
        (
            "kind = \"mqtt\"\nurl = \"mqtt://x/topic\"\n",
            "holds more than a server",
        ),
        (
            "kind = \"webhook\"\nurl = \"http://x\"\ntopic = \"t\"\n",
            "sink[0].topic: has no effect here",
        ),
        (
            "kind = \"webhook\"\nurl = \"http://x\"\nwhat = 1\n",
            "unknown key",
        ),
        (
            "kind = \"webhook\"\nurl = \"http://x\"\nheaders = [\"a b: c\"]\n",
            "sink[0].headers[0]: \"a b: c\" is no header",
        ),
        (
            "kind = \"webhook\"\nurl = \"http://x\"\nheaders = [\"Authorization: Bearer x\"]\n",
            "name a `token_file`",
        ),
        (
            "kind = \"webhook\"\nurl = \"http://x\"\nkinds = [\"drifts\"]\n",
            "sink[0].kinds[0]: \"drifts\" is not known",
        ),
        (
            "kind = \"webhook\"\nurl = \"http://x\"\nrods = [\"west\"]\n",
            "sink[0].rods[0]: there is no [[rod]] with id \"west\"",
        ),
        (
            "kind = \"webhook\"\nurl = \"http://x\"\ntoken_file = \"t\"\n",
            "sink[0].token_file: others could read it",
        ),
        (
            "kind = \"webhook\"\nurl = \"http://x\"\nca_file = \"t\"\n",
            "sink[0].ca_file: has no effect",
        ),
        (
            "kind = \"mqtt\"\nurl = \"mqtt://x\"\ntopic = \"a/#\"\n",
            "sink[0].topic: \"a/#\" is no topic",
        ),
        (
            "kind = \"mqtt\"\nurl = \"mqtt://x\"\ntopic = \"{rode}\"\n",
            "sink[0].topic: \"{rode}\" is no topic",
        ),
        (
            "kind = \"mqtt\"\nurl = \"mqtt://x\"\nuser = \"u\"\n",
            "sink[0].user: wants a `password_file`",
        ),
        (
            "kind = \"mqtt\"\nurl = \"mqtt://127.0.0.1\"\npassword_file = \"u\"\n",
            "sink[0].password_file: wants a `user`",
        ),
        (
            &format!("kind = \"mqtt\"\nurl = \"mqtt://x\"\n{login}"),
            "sink[0].password_file: others could read it",
        ),
        (
            &format!("kind = \"email\"\nurl = \"smtp://mail.org\"\n{mail}"),
            "not encrypted and not on this machine",
        ),
        (
            "kind = \"email\"\nurl = \"smtps://mail.org\"\nfrom = \"x\"\nto = []\n",
            "sink[0].from: \"x\" is no address",
        ),
        (
            "kind = \"email\"\nurl = \"smtps://mail.org\"\nfrom = \"a@b.org\"\nto = []\n",
            "sink[0].to: is empty",
        ),
        (
            &format!("kind = \"email\"\nurl = \"smtps://mail.org\"\nfrom = \"a\\nb@c.org\"\n{mail}"),
            "duplicate",
        ),
    ];
    for (sink, wanted) in cases {
        let found = faults(sink);
        assert!(
            found.iter().any(|fault| fault.contains(wanted)),
            "{sink}: {found:#?}, wanted {wanted}"
        );
    }
}

#[test]
fn ids_are_unique_and_the_log_is_not_among_them() {
    let sink = |id: &str| format!("[[sink]]\nid = \"{id}\"\nkind = \"webhook\"\nurl = \"http://x\"\n");
    for (text, wanted) in [
        (sink("a") + &sink("A"), "is the id of the sink in line"),
        (sink("log"), "is the id of the program's log"),
        (sink("a/standing"), "is no id"),
    ] {
        let error = Config::parse(&config_text(&text), "test")
            .unwrap_err()
            .to_string();
        assert!(error.contains(wanted), "{error}");
    }
}

#[test]
fn urls_say_host_port_and_encryption() {
    let of = |kind: &str, url: &str| {
        let more = if kind == "email" {
            "from = \"a@b.org\"\nto = [\"c@d.org\"]\n"
        } else {
            ""
        };
        let text = format!("[[sink]]\nid = \"a\"\nkind = \"{kind}\"\nurl = \"{url}\"\n{more}");
        match sinks(&text).remove(0).kind {
            SinkKind::Mqtt(mqtt) => (mqtt.host, mqtt.port, format!("{}", mqtt.is_tls)),
            SinkKind::Email(email) => (email.host, email.port, format!("{:?}", email.security)),
            _ => unreachable!(),
        }
    };
    let expect = |host: &str, port: u16, security: &str| (host.to_owned(), port, security.to_owned());
    assert_eq!(of("mqtt", "mqtt://x"), expect("x", 1883, "false"));
    assert_eq!(of("mqtt", "mqtts://x/"), expect("x", 8883, "true"));
    assert_eq!(of("mqtt", "mqtt://[::1]:7"), expect("::1", 7, "false"));
    let security = |security: MailSecurity| format!("{security:?}");
    assert_eq!(
        of("email", "smtp://localhost"),
        expect("localhost", 25, &security(MailSecurity::Plain))
    );
    assert_eq!(
        of("email", "smtp://127.0.0.1:2525"),
        expect("127.0.0.1", 2525, "Plain")
    );
    assert_eq!(
        of("email", "smtp+starttls://m.org"),
        expect("m.org", 587, "StartTls")
    );
    assert_eq!(of("email", "smtps://m.org"), expect("m.org", 465, "Tls"));
}
