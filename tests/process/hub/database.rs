//! A PostgreSQL server as on another machine: encryption, its certificate and a password are asked for, and each that is missing is named.

use super::fleet::{Fleet, Storage, authority, text_of};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::Command;

/// What the hub says that ends by itself, with another text in the place of one of its configuration.
fn refused(fleet: &Fleet, from: &str, to: &str) -> String {
    let text = fs::read_to_string(fleet.config()).unwrap();
    assert!(text.contains(from), "{from} is not in\n{text}");
    let config = fleet.path("changed.toml");
    fs::write(&config, text.replace(from, to)).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_tirante"))
        .args(["hub", "--config"])
        .arg(config)
        .output()
        .unwrap();
    let said = text_of(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    said
}

#[test]
fn a_guarded_database_is_folded_into_and_what_it_misses_is_named() {
    let Some(mut fleet) = Fleet::secure(&["todi"], Storage::Postgres) else {
        return;
    };
    let ca = fleet.path("ca.pem").display().to_string();
    let named = |from: &str, to: &str, told: &str| {
        let said = refused(&fleet, from, to);
        assert!(
            said.contains(told),
            "`{to}` for `{from}`: {told} is not in\n{said}"
        );
    };
    let of = |name: &str| fleet.path(name).display().to_string();
    let in_database = |ca: &str| format!("ca = \"{ca}\"\n[http]");
    // The server asks for encryption.
    named(
        &in_database(&ca),
        "[http]",
        "no encryption (without `ca`, not encrypted)",
    );
    // The certificate is of another authority, or of another name; the file holds none.
    authority(&fleet.path("other.pem"));
    fs::write(fleet.path("empty.pem"), "").unwrap();
    let other = of("other.pem");
    let told = format!("invalid peer certificate: BadSignature (`ca` is {other})");
    named(&in_database(&ca), &in_database(&other), &told);
    named(
        &in_database(&ca),
        &in_database(&of("empty.pem")),
        "holds no certificate",
    );
    named(&in_database(&ca), &in_database(&of("absent.pem")), "absent.pem");
    named("host=localhost", "host=127.0.0.1", "not valid for name");
    // The password is another one, open to everybody, or missing.
    let write = |name: &str, mode: u32| {
        fs::write(fleet.path(name), "another").unwrap();
        fs::set_permissions(fleet.path(name), fs::Permissions::from_mode(mode)).unwrap();
        of(name)
    };
    let password = of("password");
    named(
        &password,
        &write("another", 0o600),
        "password authentication failed",
    );
    named(&password, &write("open", 0o644), "chmod 600");
    named(&format!("password_file = \"{password}\""), "", "password missing");

    fleet.start();
    fleet.wait_until_equal();
    let connections = |condition: &str| {
        fleet.rows(&format!(
            "SELECT 1 FROM pg_stat_ssl JOIN pg_stat_activity USING (pid) WHERE usename = 'centre' AND {condition}"
        ))
    };
    assert!(connections("ssl") > 0);
    assert_eq!(connections("NOT ssl"), 0);
}
