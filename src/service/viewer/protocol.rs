//! The WebSocket protocol of robotics viewers, `foxglove.sdk.v1` and its elder name `foxglove.websocket.v1`
//! (<https://github.com/foxglove/ws-protocol>, docs/spec.md): the server advertises channels, the viewer subscribes, messages
//! come as binary frames.

use super::{Message, Topic};
use crate::analysis::signal::record::Timestamp;
use crate::recording::write::Encoding;
use serde::Deserialize;
use serde_json::{Value as Json, json};

/// Subprotocols of which a viewer must offer one as `Sec-WebSocket-Protocol`; for the messages used here,
/// both mean the same.
pub const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

/// First byte of a message's frame.
const MESSAGE_DATA: u8 = 1;

/// Level of a status message: a request was ignored.
const WARNING: u8 = 1;

/// Request of a viewer; other operations of the protocol are not offered.
#[derive(Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub enum Request {
    /// Messages of these channels from now on.
    Subscribe {
        /// Subscriptions, with numbers chosen by the viewer.
        subscriptions: Vec<Subscription>,
    },
    /// Ends these subscriptions.
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        /// Numbers of the subscriptions.
        subscription_ids: Vec<u32>,
    },
    /// An operation that is not offered.
    #[serde(other)]
    Other,
}

/// A channel asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Subscription {
    /// Number that its messages carry.
    pub id: u32,
    /// Number of the channel.
    pub channel_id: u32,
}

/// First message of the server.
pub fn server_info(name: &str) -> String {
    json!({"op": "serverInfo", "name": name, "capabilities": [], "supportedEncodings": [], "metadata": {}})
        .to_string()
}

/// Message that advertises channels, with their numbers.
pub fn advertise<'t>(channels: impl IntoIterator<Item = (u32, &'t Topic)>) -> String {
    let channels: Vec<Json> = channels
        .into_iter()
        .map(|(id, topic)| {
            let (name, form, schema) = topic.schema(Encoding::Json);
            json!({"id": id, "topic": topic.to_string(), "encoding": Encoding::Json.key(), "schemaName": name,
                "schema": String::from_utf8_lossy(&schema), "schemaEncoding": form})
        })
        .collect();
    json!({"op": "advertise", "channels": channels}).to_string()
}

/// Status message for people, shown beside the connection.
pub fn warning(message: &str) -> String {
    json!({"op": "status", "level": WARNING, "message": message}).to_string()
}

/// Frame of a message under a subscription: its kind, the subscription \[u32\], the time of sending
/// \[u64, ns\], both little-endian, and the message as JSON.
pub fn message(subscription: u32, told: Timestamp, message: &Message) -> Vec<u8> {
    let body = message.body.to_string();
    let mut frame = Vec::with_capacity(13 + body.len());
    frame.push(MESSAGE_DATA);
    frame.extend(subscription.to_le_bytes());
    frame.extend(told.as_nanos().max(0).unsigned_abs().to_le_bytes());
    frame.extend(body.as_bytes());
    frame
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_read_as_viewers_write_them() {
        let read = |text| serde_json::from_str::<Request>(text).ok();
        assert_eq!(
            read(r#"{"op":"subscribe","subscriptions":[{"id":7,"channelId":3}]}"#),
            Some(Request::Subscribe {
                subscriptions: vec![Subscription { id: 7, channel_id: 3 }]
            })
        );
        assert_eq!(
            read(r#"{"op":"unsubscribe","subscriptionIds":[7,8]}"#),
            Some(Request::Unsubscribe {
                subscription_ids: vec![7, 8]
            })
        );
        assert_eq!(
            read(r#"{"op":"getParameters","parameterNames":[]}"#),
            Some(Request::Other)
        );
        assert_eq!(read(r#"{"op":"subscribe"}"#), None);
        assert_eq!(read("[]"), None);
    }

    #[test]
    fn a_frame_is_laid_out_as_the_specification_says() {
        let said = Message {
            topic: Topic::Alarms,
            time: Timestamp::from_nanos(5),
            body: json!({"a": 1}),
        };
        let frame = message(0x0403_0201, Timestamp::from_nanos(0x0807_0605_0403_0201), &said);
        assert_eq!(frame[..5], [1, 1, 2, 3, 4]);
        assert_eq!(frame[5..13], [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(&frame[13..], br#"{"a":1}"#);
    }
}
