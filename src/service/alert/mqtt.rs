//! A message to an MQTT 5 broker with QoS 1: delivered when the broker acknowledges it.
//!
//! MQTT 5 and not 3.1.1: there a broker acknowledges messages that it then drops for lack of permission.

use super::{Failure, Message, Sink};
use crate::analysis::numerics::random;
use crate::config::settings::alert::{MqttSettings, TOPIC_PLACES};
use crate::service::tls;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{Packet, PubAckReason};
use rumqttc::v5::{Client, Event, MqttOptions};
use rumqttc::{TlsConfiguration, Transport};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Keep-alive interval while waiting for the broker's answer.
const KEEP_ALIVE: Duration = Duration::from_secs(5);

/// An MQTT broker as a sink.
pub(super) struct Mqtt {
    settings: MqttSettings,
    client_id: String,
    deadline: Duration,
}

impl Mqtt {
    pub(super) fn new(settings: MqttSettings, site: &str, id: &str, deadline: Duration) -> Self {
        let own = random::seed(&[b"mqtt", site.as_bytes(), id.as_bytes()]);
        Self {
            settings,
            // Brokers must allow 23 letters and digits.
            client_id: format!("tirante{own:016x}"),
            deadline,
        }
    }

    pub(super) fn options(&self) -> Result<MqttOptions, Failure> {
        let settings = &self.settings;
        let mut options = MqttOptions::new(&self.client_id, &settings.host, settings.port);
        options
            .set_keep_alive(KEEP_ALIVE)
            .set_clean_start(true)
            .set_connection_timeout(self.deadline.as_secs().max(1));
        if let Some(login) = &settings.login {
            options.set_credentials(&login.user, login.password_file.read_line()?);
        }
        if settings.is_tls {
            let tls = tls::client(settings.ca_file.as_ref()).map_err(Failure::new)?;
            let tls = TlsConfiguration::Rustls(Arc::new(tls));
            options.set_transport(Transport::tls_with_config(tls));
        }
        Ok(options)
    }
}

impl Sink for Mqtt {
    /// Opens one connection per message: alarms are rare, and a connection that is not kept cannot be
    /// half dead.
    fn deliver(&mut self, message: &Message) -> Result<(), Failure> {
        let MqttSettings { host, port, .. } = &self.settings;
        let failed = |reason: String| Failure::new(format!("mqtt broker {host}:{port}: {reason}"));
        let topic = topic(&self.settings.topic, message);
        let (client, mut connection) = Client::new(self.options()?, 4);
        client
            .publish(
                topic.clone(),
                QoS::AtLeastOnce,
                self.settings.is_retained,
                message.json(),
            )
            .map_err(|error| failed(error.to_string()))?;
        let until = Instant::now() + self.deadline;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let event = connection.recv_timeout(left).map_err(|_| {
                failed(format!(
                    "no acknowledgement within {:.0} s",
                    self.deadline.as_secs_f64()
                ))
            })?;
            match event.map_err(|error| failed(error.to_string()))? {
                Event::Incoming(Packet::PubAck(ack)) => {
                    // Polite, and not waited for: the message is there.
                    let _ = client.try_disconnect();
                    let _ = connection.recv_timeout(left.min(Duration::from_millis(100)));
                    return match ack.reason {
                        PubAckReason::Success | PubAckReason::NoMatchingSubscribers => Ok(()),
                        reason => Err(failed(format!("refuses topic {topic}: {reason:?}"))),
                    };
                }
                Event::Incoming(Packet::Disconnect(end)) => {
                    return Err(failed(format!("ends the connection: {:?}", end.reason_code)));
                }
                _ => {}
            }
        }
    }
}

/// Topic of a message. Each placeholder is replaced by a single level, without wildcards.
fn topic(template: &str, message: &Message) -> String {
    let values = [
        &message.site,
        &message.rod,
        &message.kind,
        message.what.code(),
        &message.alarm,
    ];
    let mut topic = template.to_owned();
    for (place, value) in TOPIC_PLACES.iter().zip(values) {
        // What concerns the daemon has no rod.
        let value = if value.is_empty() { "-" } else { value };
        topic = topic.replace(place, &level(value));
    }
    topic
}

/// A name as one level of a topic, without wildcards.
pub(super) fn level(name: &str) -> String {
    let is_odd = |c: char| "/+#{}$".contains(c) || c.is_control();
    name.chars().map(|c| if is_odd(c) { '_' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::record::Timestamp;

    #[test]
    fn a_name_is_one_level_of_the_topic() {
        let message = Message::test("Duomo/#1 {rod}", "m", Timestamp::from_nanos(0));
        assert_eq!(
            topic("a/{site}/{rod}/{kind}/{what}/{alarm}", &message),
            "a/Duomo__1 _rod_/test/test/test/test"
        );
    }
}
