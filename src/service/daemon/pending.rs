//! Conditions that were told past the store, which does not have them yet: a line beside the store keeps them over a restart, so that
//! the next daemon can tell their end.

use crate::analysis::signal::record::Timestamp;
use crate::site::store::ConditionEvent;

/// Room of the line \[bytes\]: the rest of the lock's file is for people.
const ROOM: usize = 1200;
/// Longest detail kept, in characters.
const LONGEST: usize = 100;

/// Fault, subject, begin \[ns since 1970\] and detail of one.
type Entry = (String, String, i64, String);

/// The line: of `unkept` notices the begins without an end, the oldest first, as many as there is room for.
pub fn line(unkept: &[ConditionEvent]) -> String {
    let has_ended = |begun: &ConditionEvent| {
        let mut others = unkept.iter();
        others.any(|other| !other.is_raised && other.condition == begun.condition)
    };
    let begins = unkept
        .iter()
        .filter(|notice| notice.is_raised && !has_ended(notice));
    let mut entries: Vec<Entry> = begins
        .map(|begun| {
            let detail = begun.detail.chars().take(LONGEST).collect();
            (
                begun.fault.clone(),
                begun.about.clone(),
                begun.raised.as_nanos(),
                detail,
            )
        })
        .collect();
    loop {
        if entries.is_empty() {
            return String::new();
        }
        let line = serde_json::to_string(&entries).unwrap_or_default();
        if line.len() <= ROOM {
            return line;
        }
        entries.pop();
    }
}

/// Begins in a line; none if it is empty, or an older version's.
pub fn begins(line: &str) -> Vec<ConditionEvent> {
    let entries: Vec<Entry> = serde_json::from_str(line).unwrap_or_default();
    entries
        .into_iter()
        .map(|(fault, about, raised_ns, detail)| {
            ConditionEvent::raised(&fault, &about, Timestamp::from_nanos(raised_ns), &detail)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::site::clock;

    #[test]
    fn the_begins_without_an_end_come_back_from_the_line() {
        let begun = ConditionEvent::raised("disk-full", "site.db", clock::now(), "no room on the disk");
        let other = ConditionEvent::raised("sink", "mail", clock::now(), "refused");
        let unkept = [begun.clone(), other.clone(), other.cleared(clock::now())];
        assert_eq!(begins(&line(&unkept)), [begun]);
        assert_eq!(begins(""), []);
        assert_eq!(begins("[{\"kind\": \"disk-full\"}]"), []);
    }

    #[test]
    fn a_line_has_room_for_whole_entries() {
        let many: Vec<_> = (0..100)
            .map(|number| {
                ConditionEvent::raised("sink", &format!("hook {number}"), clock::now(), &"ä".repeat(500))
            })
            .collect();
        let text = line(&many);
        assert!(text.len() <= ROOM, "{}", text.len());
        assert!(begins(&text).len() >= 4);
        assert_eq!(line(&[]), "");
    }
}
