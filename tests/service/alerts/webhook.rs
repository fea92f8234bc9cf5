//! HTTP itself: secrets, certificates, and `tirante alarm test`.

use super::desk::*;
use super::fake::{Answer, Fake};
use assert_cmd::Command;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use tirante::service::alert::{self, Message};
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::PrivateKeyDer;

/// A server with a certificate of its own for `localhost`, which is written to `ca`.
fn encrypted(ca: &Path) -> Fake {
    let own = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    fs::write(ca, own.cert.pem()).unwrap();
    let key = PrivateKeyDer::try_from(own.signing_key.serialize_der()).unwrap();
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_no_client_auth()
        .with_single_cert(vec![own.cert.der().clone()], key)
        .unwrap();
    Fake::at("127.0.0.1:0".parse().unwrap(), &[], Some(Arc::new(config)))
}

fn test_message() -> Message {
    Message::test(SITE, "hook", at(0))
}

#[test]
fn https_trusts_the_named_certificates_only() {
    let desk = Desk::new();
    let (ca, token) = (desk.path("ca.pem"), desk.secret("token", "first\n"));
    let fake = encrypted(&ca);
    let text = format!(
        "[[sink]]\nid = \"hook\"\nkind = \"webhook\"\nurl = \"https://localhost:{}/x\"\ntoken_file = {token:?}\n",
        fake.address.port()
    );
    let deliver = |text: &str| {
        let mut sink = alert::open(&sinks(text)[0], SITE, alert::Pace::default().deadline);
        sink.deliver(&test_message())
    };
    let refused = deliver(&text).unwrap_err().reason;
    assert!(refused.contains("certificate"), "{refused}");
    let trusting = format!("{text}ca_file = {ca:?}\n");
    assert_eq!(deliver(&trusting), Ok(()));
    // Changed secrets hold from the next message on.
    desk.secret("token", "second\n");
    assert_eq!(deliver(&trusting), Ok(()));
    let tokens: Vec<String> = fake
        .requests()
        .iter()
        .map(|request| request.headers["authorization"].clone())
        .collect();
    assert_eq!(tokens, ["Bearer first", "Bearer second"]);
    fs::remove_file(&token).unwrap();
    let missing = deliver(&trusting).unwrap_err().reason;
    assert!(missing.contains("token"), "{missing}");
    fs::write(&ca, "nothing").unwrap();
    let empty = deliver(&trusting).unwrap_err().reason;
    assert!(empty.contains("holds no certificate"), "{empty}");
}

#[test]
fn alarm_test_says_which_sinks_have_it() {
    let desk = Desk::new();
    let (good, bad) = (Fake::new(&[]), Fake::new(&vec![Answer::Status(401, ""); 9]));
    let site = desk.path("site.toml");
    let sinks = format!(
        r#"
[[sink]]
id = "good"
kind = "webhook"
url = "{}/hook"
token_file = "$CREDENTIALS_DIRECTORY/token"
headers = ["X-Site: Duomo"]
[[sink]]
id = "bad"
kind = "alertmanager"
url = "{}"
"#,
        good.url(),
        bad.url()
    );
    fs::write(&site, config_text(&sinks)).unwrap();
    desk.secret("token", "secret-1234\n");
    let run = |args: &[&str]| {
        let mut command = Command::cargo_bin("tirante").unwrap();
        command
            .args(["alarm", "test", "--config"])
            .arg(&site)
            .args(args)
            .env("CREDENTIALS_DIRECTORY", desk.folder.path());
        let output = command.output().unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        (output.status.code(), text(output.stdout), text(output.stderr))
    };
    let (code, out, err) = run(&[]);
    assert_eq!(code, Some(1), "{err}");
    let lines: Vec<&str> = out.lines().collect();
    assert!(lines[0].starts_with("good: delivered, id test-good-"), "{out}");
    assert!(
        lines[1].starts_with("bad: NOT delivered: ") && lines[1].contains("401"),
        "{out}"
    );
    assert!(lines[2].starts_with("log: delivered"), "{out}");
    assert!(err.contains("Duomo: test of an alarm sink"), "{err}");
    assert!(!out.contains("secret-1234") && !err.contains("secret-1234"));
    let request = &good.requests()[0];
    assert_eq!(request.path, "/hook");
    assert_eq!(request.headers["authorization"], "Bearer secret-1234");
    assert_eq!(request.headers["x-site"], "Duomo");
    assert_eq!(request.body["what"], "test");
    let bad_request = &bad.requests()[0];
    assert_eq!(bad_request.path, "/api/v2/alerts");
    assert_eq!(bad_request.body[0]["labels"]["alertname"], "TiranteTest");

    assert_eq!(run(&["--sink", "good"]).0, Some(0));
    assert_eq!(good.requests().len(), 2);
    assert_eq!(bad.requests().len(), 1);
    let (code, _, err) = run(&["--sink", "goood"]);
    assert_eq!(code, Some(2));
    assert!(err.contains("only good, bad, log"), "{err}");
}
