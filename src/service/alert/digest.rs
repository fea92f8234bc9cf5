//! Several messages in one mail: what a power cut or an outage of the mail server brings.

use super::Message;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

/// Most messages listed in full; a mail may not grow without bound.
const LISTED: usize = 200;

/// Subject of several messages: how many of each kind, and of how many sites.
pub(super) fn subject(messages: &[Message]) -> String {
    let sites: BTreeSet<&str> = messages.iter().map(|message| message.site.as_str()).collect();
    let whose = match (sites.first(), sites.len()) {
        (Some(site), 1) => (*site).to_owned(),
        (_, count) => format!("{count} sites"),
    };
    let mut counts: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    for message in messages {
        *counts.entry((&message.kind, message.what.code())).or_default() += 1;
    }
    let kinds: Vec<String> = counts
        .iter()
        .map(|((kind, what), count)| format!("{count} {kind} {what}"))
        .collect();
    format!("{whose}: {} messages: {}", messages.len(), kinds.join(", "))
}

/// Text of several messages, in their order, one paragraph each; those of a centre by site.
pub(super) fn text(messages: &[Message]) -> String {
    let mut sites: Vec<&str> = Vec::new();
    for message in messages {
        if !sites.contains(&message.site.as_str()) {
            sites.push(&message.site);
        }
    }
    let mut text = String::new();
    let mut listed = 0;
    for site in &sites {
        let of_site: Vec<&Message> = messages.iter().filter(|message| message.site == *site).collect();
        if sites.len() > 1 && listed < LISTED {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "== {site}: {} messages\n", of_site.len());
        }
        for message in of_site {
            listed += 1;
            if listed > LISTED {
                break;
            }
            let whose = match &message.about {
                Some(about) => format!("of the monitoring ({about})"),
                None => format!("rod {}", message.rod),
            };
            let words = message.acknowledged_words.as_ref();
            let said = words.map_or_else(String::new, |words| format!("\n    acknowledged by {words}"));
            let _ = writeln!(
                text,
                "{} {}, {whose}, {}\n    {}{said}\n    alarm {}\n",
                message.kind,
                message.what.code(),
                message.time,
                message.message,
                message.alarm
            );
        }
    }
    let is_of_centre = messages.iter().any(Message::is_of_centre);
    if let Some(more @ 1..) = messages.len().checked_sub(LISTED) {
        let look = if is_of_centre {
            "tirante hub sites"
        } else {
            "tirante history --what alarms"
        };
        let _ = writeln!(text, "and {more} more: `{look}`\n");
    }
    text += if is_of_centre {
        "`tirante hub sites --config hub.toml` shows what stands; `tirante hub command SITE acknowledge ALARM --by NAME --reason TEXT` says that \
         somebody knows."
    } else {
        "`tirante status` shows what stands; `tirante ack --config FILE ALARM` says that somebody knows."
    };
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
        let mut known = messages.clone();
        known[3].acknowledged_words = Some("M. Rossi: wedge sound".to_owned());
        assert!(text(&known).contains("\n    acknowledged by M. Rossi: wedge sound\n    alarm a3\n"));
        let said = text(&messages);
        for rod in 0..40 {
            assert!(said.contains(&format!("rod nave-{rod},")), "{said}");
        }
        let of_centre = |site: &str, rod: usize| Message {
            site: site.to_owned(),
            id: format!("{site}/a{rod}-raised-1"),
            ..of(rod, "no-data")
        };
        let messages = [of_centre("todi", 1), of_centre("gubbio", 2), of_centre("todi", 3)];
        assert_eq!(subject(&messages), "2 sites: 3 messages: 3 no-data test");
        let said = text(&messages);
        let place = |part: &str| said.find(part).unwrap_or_else(|| panic!("{part}: {said}"));
        assert!(place("== todi: 2") < place("rod nave-1") && place("rod nave-1") < place("rod nave-3"));
        assert!(place("rod nave-3") < place("== gubbio: 1") && said.contains("hub command SITE acknowledge"));
        let many: Vec<Message> = (0..LISTED + 7).map(|rod| of(rod, "sensor")).collect();
        assert!(text(&many).contains("and 7 more"));
    }
}
