//! Several messages in one mail: what a power cut or an outage of the mail server brings.

use super::Message;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Most messages listed in full; a mail may not grow without bound.
const LISTED: usize = 200;

/// Subject of several messages: how many of each kind.
pub(super) fn subject(messages: &[Message]) -> String {
    let site = messages.first().map_or("", |message| message.site.as_str());
    let mut counts: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    for message in messages {
        *counts.entry((&message.kind, message.what.code())).or_default() += 1;
    }
    let kinds: Vec<String> = counts
        .iter()
        .map(|((kind, what), count)| format!("{count} {kind} {what}"))
        .collect();
    format!("{site}: {} messages: {}", messages.len(), kinds.join(", "))
}

/// Text of several messages, in their order, one paragraph each.
pub(super) fn text(messages: &[Message]) -> String {
    let mut text = String::new();
    for message in messages.iter().take(LISTED) {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{} {}, rod {}, {}\n    {}\n    alarm {}\n",
            message.kind,
            message.what.code(),
            message.rod,
            message.time,
            message.message,
            message.alarm
        );
    }
    if let Some(more @ 1..) = messages.len().checked_sub(LISTED) {
        let _ = writeln!(text, "and {more} more: `tirante history --what alarms`\n");
    }
    text += "`tirante status` shows what stands; `tirante ack --config FILE ALARM` says that somebody knows.";
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::record::Timestamp;

    #[test]
    fn a_digest_counts_by_kind_and_names_every_rod() {
        let of = |rod: usize, kind: &str| Message {
            rod: format!("nave-{rod}"),
            kind: kind.to_owned(),
            alarm: format!("a{rod}"),
            ..Message::test("Duomo", "mail", Timestamp::from_nanos(1_800_000_000_000_000_000))
        };
        let messages: Vec<Message> = (0..39)
            .map(|rod| of(rod, "no-data"))
            .chain([of(39, "drift")])
            .collect();
        assert_eq!(
            subject(&messages),
            "Duomo: 40 messages: 1 drift test, 39 no-data test"
        );
        let said = text(&messages);
        for rod in 0..40 {
            assert!(said.contains(&format!("rod nave-{rod},")), "{said}");
        }
        let many: Vec<Message> = (0..LISTED + 7).map(|rod| of(rod, "sensor")).collect();
        assert!(text(&many).contains("and 7 more"));
    }
}
