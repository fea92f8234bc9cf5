//! Rights at a real server with TLS: a stolen credential writes its own site and reads its own answers, until it is revoked.

use super::fleet::{Fleet, Storage};
use crate::site::Part;
use async_nats::jetstream;
use futures_util::StreamExt;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tirante::service::forward::message::Label;
use tirante::service::forward::throttle;
use tirante::site::store::FORMAT;

/// What a client may not do is reported beside its answers.
async fn refusals(
    options: async_nats::ConnectOptions,
    address: &str,
) -> (async_nats::Client, Arc<Mutex<Vec<String>>>) {
    let said = Arc::<Mutex<Vec<String>>>::default();
    let hears = Arc::clone(&said);
    let client = options
        .custom_inbox_prefix("_INBOX_todi")
        .event_callback(move |event| {
            hears.lock().unwrap().push(event.to_string());
            std::future::ready(())
        })
        .connect(address)
        .await
        .unwrap();
    (client, said)
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap()
}

#[test]
fn a_stolen_credential_writes_its_own_site_alone_until_it_is_revoked() {
    let Some(mut fleet) = Fleet::secure(&["todi", "gubbio"], Storage::Sqlite) else {
        return;
    };
    fleet.start();
    fleet.wait_until_equal();
    fleet.wait_until_beating();
    let (seed, ca, port) = (fleet.seed("todi"), fleet.path("ca.pem"), fleet.nats_port());
    let address = format!("tls://localhost:{port}");
    runtime().block_on(async {
        let options = async_nats::ConnectOptions::with_nkey(seed)
            .require_tls(true)
            .add_root_certificates(ca);
        let (client, said) = refusals(options, &address).await;
        let jetstream = jetstream::new(client.clone());
        let brief = Duration::from_millis(600);
        // Each of these may not be asked: nobody answers, and the server names the subject.
        let forbidden = [
            "tirante.v1.out.gubbio",
            "tirante.v1.out.todi.more",
            "tirante.v1.beat.gubbio",
            "tirante.v1.cmd.todi",
            "tirante.v1.cmd.gubbio",
            "tirante.v1.pause",
            "$JS.API.STREAM.MSG.GET.TIRANTE_CMD",
            "$JS.API.STREAM.CREATE.TIRANTE_CMD",
            "$JS.API.DIRECT.GET.TIRANTE_CMD",
            "$JS.API.DIRECT.GET.TIRANTE_CMD.tirante.v1.cmd.gubbio",
            "$JS.API.STREAM.INFO.TIRANTE_BEAT",
            "$JS.API.STREAM.MSG.GET.TIRANTE_BEAT",
            "$JS.API.STREAM.DELETE.TIRANTE_BEAT",
            "$JS.API.DIRECT.GET.TIRANTE_BEAT.tirante.v1.beat.gubbio",
            "$JS.API.STREAM.INFO.TIRANTE_OUT",
            "$JS.API.STREAM.NAMES",
            "$JS.API.STREAM.PURGE.TIRANTE_OUT",
            "$JS.API.STREAM.DELETE.TIRANTE_OUT",
            "$JS.API.STREAM.MSG.GET.TIRANTE_OUT",
            "$JS.API.DIRECT.GET.TIRANTE_OUT",
            "$JS.API.DIRECT.GET.TIRANTE_OUT.tirante.v1.out.gubbio",
            "$JS.API.CONSUMER.CREATE.TIRANTE_OUT",
            "$SYS.REQ.SERVER.PING",
        ];
        for subject in forbidden {
            let asked = tokio::time::timeout(brief, client.request(subject, "x".into())).await;
            assert!(
                asked.is_err() || asked.unwrap().is_err(),
                "{subject} was answered"
            );
            let heard = said
                .lock()
                .unwrap()
                .iter()
                .any(|line| line.contains(&format!("\"{subject}\"")));
            assert!(heard, "{subject}: {:?}", said.lock().unwrap());
        }
        for subject in [
            "tirante.>",
            "tirante.v1.cmd.gubbio",
            "tirante.v1.cmd.todi",
            "tirante.v1.beat.>",
            "_INBOX_gubbio.>",
            "_INBOX.>",
            ">",
        ] {
            let mut listening = client.subscribe(subject).await.unwrap();
            client.flush().await.unwrap();
            tokio::time::sleep(Duration::from_millis(100)).await;
            listening.unsubscribe().await.unwrap();
            let heard = said
                .lock()
                .unwrap()
                .iter()
                .any(|line| line.contains("Subscription") && line.contains(subject));
            assert!(heard, "{subject}: {:?}", said.lock().unwrap());
        }
        // The pauses it hears, from the hub alone.
        let mut pauses = client.subscribe(throttle::SUBJECT).await.unwrap();
        client.flush().await.unwrap();
        let hub = async_nats::ConnectOptions::with_nkey(fleet.seed("HUB"))
            .require_tls(true)
            .add_root_certificates(fleet.path("ca.pem"))
            .connect(&address)
            .await
            .unwrap();
        hub.publish(throttle::SUBJECT, "x".into()).await.unwrap();
        hub.flush().await.unwrap();
        let heard = tokio::time::timeout(Duration::from_secs(10), pauses.next()).await;
        assert_eq!(heard.unwrap().unwrap().payload, "x");
        // Its own site it does write: that is what the credential is for. The centre parks what it cannot read.
        let ack = jetstream
            .publish("tirante.v1.out.todi", "forged".into())
            .await
            .unwrap();
        ack.await.unwrap();
    });
    fleet.wait_until_marked("todi", "unreadable");
    fleet.assert_equal(0, &[]);
    fleet.assert_equal(1, &[]);
    // A forged last message that claims a commit which was never sent, with nothing in it that can be read: the site does not
    // believe it.
    fleet.stop_edge(0);
    let (epoch, own) = fleet.end_of(0);
    runtime().block_on(async {
        let options = async_nats::ConnectOptions::with_nkey(fleet.seed("todi"))
            .require_tls(true)
            .add_root_certificates(fleet.path("ca.pem"));
        let (client, _) = refusals(options, &address).await;
        let label = Label {
            epoch,
            first: own + 1,
            last: own + 1,
            format: FORMAT,
            mark: "1.2.3.4".to_owned(),
        };
        let mut headers = async_nats::HeaderMap::new();
        for (name, values) in label.headers(0).iter() {
            if name.to_string().starts_with("Tirante-") {
                headers.insert(name.clone(), values[0].clone());
            }
        }
        let ack = jetstream::new(client.clone())
            .publish_with_headers("tirante.v1.out.todi", headers, "forged".into())
            .await
            .unwrap();
        ack.await.unwrap();
    });
    fleet.edges[0].site.simulate("later", &Part::new(70, 2));
    fleet.start_edge(0);
    fleet.wait_until_read(0, 8);
    fleet.wait_until_sent_of(0);
    let told = "give the site the rights of config/fleet/rights.conf";
    let log = std::fs::read_to_string(fleet.edges[0].site.path("daemon.log")).unwrap();
    assert!(!log.contains(told), "{log}");
    // With the rights of before the pauses, it works and says what it lacks; nothing else is blamed on it.
    fleet.take_pauses();
    fleet.stop_edge(0);
    let before = fleet.logged(0);
    fleet.start_edge(0);
    fleet.wait_for_log(0, before, told);
    fleet.edges[0].site.simulate("latest", &Part::new(80, 2));
    fleet.wait_until_read(0, 9);
    fleet.wait_until_sent_of(0);
    // Revoked, it is out at once; its site keeps its results, and the others go on.
    let before = fleet.logged(0);
    fleet.revoke("todi");
    fleet.more_records(0);
    fleet.wait_for_log(0, before, "forward to nats+tls://");
    fleet.more_records(1);
    fleet.wait_until_sent_of(1);
    let seed = fleet.seed("todi");
    let ca = fleet.path("ca.pem");
    let refused = runtime().block_on(async {
        async_nats::ConnectOptions::with_nkey(seed)
            .require_tls(true)
            .add_root_certificates(ca)
            .connect(&address)
            .await
    });
    assert!(refused.is_err());
}
