//! A real SMTP server (aiosmtpd): every kind of encryption, login, refusals.

use super::desk::*;
use super::peers::missing;
use serde_json::Value;
use std::fs;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Instant;
use tirante::analysis::track::{Kind, What};
use tirante::service::alert::{self, Failure, Message, Pace};

struct Mailer {
    child: Child,
    port: u16,
    mails: Arc<Mutex<Vec<Value>>>,
}

impl Drop for Mailer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A Python that has aiosmtpd.
fn python() -> Option<&'static str> {
    let found = ["/usr/bin/python3", "python3"].into_iter().find(|python| {
        Command::new(python)
            .args(["-c", "import aiosmtpd"])
            .stderr(Stdio::null())
            .status()
            .is_ok_and(|status| status.success())
    });
    if found.is_none() {
        missing("python3-aiosmtpd");
    }
    found
}

impl Mailer {
    fn start(desk: &Desk, mode: &str, refused: usize) -> Option<Self> {
        let python = python()?;
        let own = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        fs::write(desk.path("mail.pem"), own.cert.pem()).unwrap();
        fs::write(desk.path("mail.key"), own.signing_key.serialize_pem()).unwrap();
        desk.secret("password", "secret\n");
        let mut child = Command::new(python)
            .args(["-c", include_str!("mail.py")])
            .args([desk.path("mail.pem"), desk.path("mail.key")])
            .args([mode, &refused.to_string()])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let port = lines.next().unwrap().unwrap().parse().unwrap();
        let mails = Arc::new(Mutex::new(Vec::new()));
        let kept = Arc::clone(&mails);
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                kept.lock().unwrap().push(serde_json::from_str(&line).unwrap());
            }
        });
        Some(Self { child, port, mails })
    }

    fn sink(&self, desk: &Desk, scheme: &str, to: &str, more: &str) -> String {
        let password = desk.path("password");
        let group = if more.contains("group_s") {
            ""
        } else {
            "group_s = 0\n"
        };
        format!(
            "[[sink]]\nid = \"mail\"\nkind = \"email\"\nurl = \"{scheme}://localhost:{}\"\nfrom = \"Duomo <rods@example.org>\"\n\
             to = [{to}]\nuser = \"tirante\"\npassword_file = {password:?}\n{group}{more}",
            self.port
        )
    }

    fn ca(desk: &Desk) -> String {
        format!("ca_file = {:?}\n", desk.path("mail.pem"))
    }

    /// Mails that came, once there are `number`: a thread reads them from the server's output, behind the sink's position.
    fn mails(&self, number: usize) -> Vec<Value> {
        eventually("the mails", || self.mails.lock().unwrap().len() >= number);
        self.mails.lock().unwrap().clone()
    }
}

fn deliver(text: &str) -> Result<(), Failure> {
    let mut sink = alert::open(&sinks(text)[0], SITE, Pace::default().deadline);
    sink.deliver(&Message::test(SITE, "mail", at(0)))
}

#[test]
fn every_kind_of_encryption_carries_a_mail() {
    for (mode, scheme) in [
        ("plain", "smtp"),
        ("starttls", "smtp+starttls"),
        ("smtps", "smtps"),
    ] {
        let desk = Desk::new();
        let Some(server) = Mailer::start(&desk, mode, 0) else {
            return;
        };
        let is_encrypted = mode != "plain";
        let ca = if is_encrypted {
            Mailer::ca(&desk)
        } else {
            String::new()
        };
        let text = server.sink(&desk, scheme, "\"a@example.org\", \"B <b@example.org>\"", &ca);
        assert_eq!(deliver(&text), Ok(()), "{mode}");
        let mail = &server.mails(1)[0];
        assert_eq!(mail["encrypted"], is_encrypted);
        assert_eq!(mail["authenticated"], true);
        assert_eq!(
            mail["recipients"],
            serde_json::json!(["a@example.org", "b@example.org"])
        );
        assert_eq!(mail["from"], "Duomo <rods@example.org>");
        assert_eq!(mail["subject"], "Duomo: test of an alarm sink");
        if is_encrypted {
            let refused = deliver(&text.replace(&ca, "")).unwrap_err();
            assert!(refused.reason.contains("certificate"), "{refused}");
        }
    }
}

#[test]
fn a_server_that_cannot_encrypt_gets_no_password() {
    let desk = Desk::new();
    let Some(server) = Mailer::start(&desk, "plain", 0) else {
        return;
    };
    let text = server.sink(&desk, "smtp+starttls", "\"a@example.org\"", &Mailer::ca(&desk));
    let refused = deliver(&text).unwrap_err();
    assert!(refused.reason.to_lowercase().contains("starttls"), "{refused}");
    assert_eq!(server.mails(0).len(), 0);
}

#[test]
fn refusals_are_told_and_tried_again() {
    let desk = Desk::new();
    let Some(server) = Mailer::start(&desk, "starttls", 2) else {
        return;
    };
    let text = server.sink(&desk, "smtp+starttls", "\"a@example.org\"", &Mailer::ca(&desk));
    let unknown = text.replace("a@example.org", "nobody@example.org");
    let refused = deliver(&unknown).unwrap_err();
    assert!(refused.reason.contains("no such user"), "{refused}");
    desk.secret("password", "wrong\n");
    let refused = deliver(&text).unwrap_err();
    assert!(refused.reason.contains("535"), "{refused}");
    desk.secret("password", "secret\n");

    let couriers = desk.start(&sinks(&text));
    eventually("the sink is known", || desk.delivered("mail") == Some(0));
    let alarm = desk.tell("north", Kind::Limit, 3, What::Raised);
    couriers.wake();
    eventually("it is marked", || desk.delivered("mail") == Some(1));
    couriers.stop();
    let mails = server.mails(3);
    assert_eq!(mails.len(), 3, "{mails:?}");
    let taken: Vec<bool> = mails
        .iter()
        .map(|mail| mail["taken"].as_bool().unwrap())
        .collect();
    assert_eq!(taken, [false, false, true]);
    let seconds = alarm.raised.as_nanos() / 1_000_000_000;
    let id = format!("<{}-raised-{seconds}@example.org>", alarm.id);
    for mail in &mails {
        assert_eq!(mail["id"], id.as_str(), "the same mail again");
        assert_eq!(mail["references"], format!("<{}@example.org>", alarm.id));
        assert_eq!(mail["subject"], "Duomo, rod north: limit raised");
        assert!(mail["body"].as_str().unwrap().starts_with("Alarm 3.\n"));
    }
}

#[test]
fn forty_alarms_of_a_minute_are_one_mail_and_a_single_one_is_as_before() {
    let desk = Desk::new();
    let Some(server) = Mailer::start(&desk, "plain", 0) else {
        return;
    };
    // Long enough for forty commits on a busy machine.
    let text = server.sink(&desk, "smtp", "\"a@example.org\"", "group_s = 4\n");
    let couriers = desk.start(&sinks(&text));
    eventually("the sink is known", || desk.delivered("mail") == Some(0));
    for rod in 0..40 {
        desk.tell(&format!("nave-{rod}"), Kind::NoData, 3, What::Raised);
        couriers.wake();
    }
    eventually("all are marked", || desk.delivered("mail") == Some(40));
    let mails = server.mails(1);
    assert_eq!(mails.len(), 1, "{mails:?}");
    let mail = &mails[0];
    assert_eq!(mail["subject"], "Duomo: 40 messages: 40 no-data raised");
    let body = mail["body"].as_str().unwrap();
    assert!(
        (0..40).all(|rod| body.contains(&format!("rod nave-{rod},"))),
        "{body}"
    );
    desk.tell("north", Kind::Limit, 4, What::Raised);
    couriers.wake();
    eventually("it is marked", || desk.delivered("mail") == Some(41));
    couriers.stop();
    assert_eq!(server.mails(2)[1]["subject"], "Duomo, rod north: limit raised");
}

#[test]
fn a_sensor_that_comes_and_goes_waits_with_its_like_and_never_with_a_word_about_the_force() {
    let desk = Desk::new();
    let Some(server) = Mailer::start(&desk, "plain", 0) else {
        return;
    };
    let text = server.sink(&desk, "smtp", "\"a@example.org\"", "group_s = 3\n");
    let couriers = desk.start(&sinks(&text));
    eventually("the sink is known", || desk.delivered("mail") == Some(0));
    let subjects = |number| -> Vec<String> {
        let of = |mail: &Value| mail["subject"].as_str().unwrap().to_owned();
        server.mails(number).iter().map(of).collect()
    };
    // Heard for minutes each hour: the first two are told as they come, the third would wait for 12 s.
    for hour in 0..8 {
        desk.tell("nave-1", Kind::NoData, hour, What::Raised);
        couriers.wake();
        if hour < 2 {
            let told = hour as i64 + 1;
            eventually("it is told", || desk.delivered("mail") == Some(told));
        }
    }
    assert_eq!(subjects(2), vec!["Duomo, rod nave-1: no-data raised"; 2]);
    desk.tell("north", Kind::Limit, 4, What::Raised);
    couriers.wake();
    eventually("all are told", || desk.delivered("mail") == Some(9));
    couriers.stop();
    assert_eq!(
        subjects(3).last().unwrap(),
        "Duomo: 7 messages: 1 limit raised, 6 no-data raised"
    );
    let body = server.mails(3)[2]["body"].as_str().unwrap().to_owned();
    assert!(body.contains("number 8 within a day"), "{body}");
}

#[test]
fn a_centre_puts_the_alarms_of_its_sites_into_one_mail_by_site() {
    let desk = Desk::new();
    let Some(server) = Mailer::start(&desk, "plain", 0) else {
        return;
    };
    let text = server.sink(&desk, "smtp", "\"a@example.org\"", "group_s = 1\n");
    let couriers = desk.start(&sinks(&text));
    eventually("the sink is known", || desk.delivered("mail/standing").is_some());
    desk.relay("todi", &["nave-1"], &[]);
    desk.relay("gubbio", &["apse"], &[]);
    desk.relay("todi", &["nave-2"], &[]);
    couriers.wake();
    eventually("all are marked", || desk.delivered("mail") == Some(3));
    couriers.stop();
    let mails = server.mails(1);
    assert_eq!(mails.len(), 1, "{mails:?}");
    assert_eq!(mails[0]["subject"], "2 sites: 3 messages: 3 sensor raised");
    let body = mails[0]["body"].as_str().unwrap();
    let order = [
        "== todi: 2 messages",
        "rod nave-1,",
        "rod nave-2,",
        "== gubbio: 1 messages",
        "rod apse,",
    ];
    let places: Vec<Option<usize>> = order.iter().map(|words| body.find(words)).collect();
    assert!(places.iter().all(Option::is_some) && places.is_sorted(), "{body}");
}

#[test]
fn a_server_that_says_nothing_is_left_after_the_deadline() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("smtp://{}", listener.local_addr().unwrap());
    let text = format!(
        "[[sink]]\nid = \"mail\"\nkind = \"email\"\nurl = \"{url}\"\nfrom = \"a@b.org\"\nto = [\"c@d.org\"]\n"
    );
    let mut sink = alert::open(&sinks(&text)[0], SITE, FAST.deadline);
    let begun = Instant::now();
    let failure = sink.deliver(&Message::test(SITE, "mail", at(0))).unwrap_err();
    assert!(failure.reason.contains("no answer within"), "{failure}");
    assert!(begun.elapsed() < 5 * FAST.deadline, "{:?}", begun.elapsed());
}
