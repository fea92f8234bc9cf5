//! Open samples with which files began that may be read again from their start.

use crate::recording::read::Tail;
use crate::site::store::Carry;
use std::collections::BTreeMap;

/// Beginning of the names under which the store keeps them, before the rod's id, the log time of the file's first message and its label.
pub(in crate::service::daemon) const BEGUN_UNDER: &str = "begun/";

/// Most bytes of them; beyond, the file that began earliest begins with nothing when it is read again.
const MOST_BYTES: usize = 32 << 20;

/// Samples with which files began, by the label of the file.
#[derive(Default)]
pub(super) struct Begun(BTreeMap<String, Start>);

/// Those of one file.
struct Start {
    /// Log time of its first message \[ns since 1970\]: another file of its name begins at another time.
    begins: u64,
    tails: Vec<Tail>,
}

impl Start {
    /// Row of the store for one; an empty body removes it.
    fn row(&self, label: &str, tail: &Tail, body: Vec<u8>) -> Carry {
        Carry {
            journal: format!("{BEGUN_UNDER}{}/{}/{label}", tail.rod, self.begins),
            part: 0,
            body,
        }
    }

    fn held(&self) -> usize {
        self.tails.iter().map(Tail::held).sum()
    }
}

impl Begun {
    /// Takes up what the store kept under this name behind [`BEGUN_UNDER`]; false if it is nothing of the kind.
    pub(super) fn load(&mut self, name: &str, tail: Tail) -> bool {
        let file = name
            .strip_prefix(&tail.rod.0)
            .and_then(|name| name.strip_prefix('/'))
            .and_then(|name| name.split_once('/'));
        let Some((Ok(begins), label)) = file.map(|(begins, label)| (begins.parse(), label)) else {
            return false;
        };
        let tails = Vec::new();
        let start = self.0.entry(label.to_owned());
        let start = start.or_insert(Start { begins, tails });
        let is_of_it = start.begins == begins;
        if is_of_it {
            start.tails.push(tail);
        }
        is_of_it
    }

    /// Samples with which a file began when it was read before.
    pub(super) fn of(&self, label: &str, begins: Option<u64>) -> Option<&[Tail]> {
        let start = self.0.get(label)?;
        (Some(start.begins) == begins).then_some(&start.tails)
    }

    /// Bytes that they take.
    pub(super) fn held(&self) -> usize {
        self.0.values().map(Start::held).sum()
    }

    /// Remembers what a file began with; returns the rows that change.
    pub(super) fn keep(&mut self, label: &str, begins: u64, tails: Vec<Tail>) -> Vec<Carry> {
        if tails.is_empty() && self.of(label, Some(begins)).is_some() {
            return Vec::new();
        }
        let mut changed = self.forget_if(|other, _| other == label);
        if tails.is_empty() {
            return changed;
        }
        let start = Start { begins, tails };
        if start.held() > MOST_BYTES {
            return changed;
        }
        while start.held() + self.held() > MOST_BYTES
            && let Some(earliest) = self.earliest()
        {
            changed.extend(self.forget_if(|other, _| other == earliest));
        }
        let rows = start
            .tails
            .iter()
            .map(|tail| start.row(label, tail, tail.encode()));
        let rows: Vec<Carry> = rows.collect();
        changed.retain(|removed| rows.iter().all(|row| row.journal != removed.journal));
        changed.extend(rows);
        self.0.insert(label.to_owned(), start);
        changed
    }

    fn earliest(&self) -> Option<String> {
        let all = self.0.iter();
        all.min_by_key(|(_, start)| start.begins)
            .map(|(label, _)| label.clone())
    }

    /// Forgets some; returns the rows to be removed.
    pub(super) fn forget_if(&mut self, is_gone: impl Fn(&str, &Tail) -> bool) -> Vec<Carry> {
        let mut rows = Vec::new();
        self.0.retain(|label, start| {
            let gone: Vec<Tail> = start.tails.extract_if(.., |tail| is_gone(label, tail)).collect();
            rows.extend(gone.iter().map(|tail| start.row(label, tail, Vec::new())));
            !start.tails.is_empty()
        });
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rod's samples of so many bytes.
    fn tail(rod: &str, bytes: usize) -> Tail {
        let moments = "1,".repeat(bytes - 1);
        let fields = format!(
            r#"{{"rod":"{rod}","to":5,"file":"a","bytes":0,"records":0,"lanes":[],"moments":[{moments}1]}}"#
        );
        serde_json::from_str(&fields).unwrap()
    }

    fn names(rows: &[Carry]) -> Vec<String> {
        let told = |row: &Carry| format!("{}{}", ["-", "+"][usize::from(!row.body.is_empty())], row.journal);
        rows.iter().map(told).collect()
    }

    #[test]
    fn a_file_is_known_by_its_name_and_first_message() {
        let mut begun = Begun::default();
        let rows = begun.keep("./sub/a.mcap", 17, vec![tail("x", 10), tail("y", 10)]);
        assert_eq!(
            names(&rows),
            ["+begun/x/17/./sub/a.mcap", "+begun/y/17/./sub/a.mcap"]
        );
        let mut loaded = Begun::default();
        for row in &rows {
            let name = row.journal.strip_prefix(BEGUN_UNDER).unwrap();
            assert!(loaded.load(name, Tail::decode(&row.body).unwrap()));
        }
        assert!(!loaded.load("x/18/./sub/a.mcap", tail("x", 10)));
        assert!(!loaded.load("x/a.mcap", tail("x", 10)));
        let known: Vec<_> = loaded
            .of("./sub/a.mcap", Some(17))
            .unwrap()
            .iter()
            .map(|tail| &tail.rod.0)
            .collect();
        assert_eq!(known, ["x", "y"]);
        assert!(loaded.of("./sub/a.mcap", Some(18)).is_none() && loaded.of("./sub/a.mcap", None).is_none());

        // A reading without a message of its rods changes nothing, another one replaces it, an end removes it.
        assert!(loaded.keep("./sub/a.mcap", 17, Vec::new()).is_empty());
        let rows = loaded.keep("./sub/a.mcap", 17, vec![tail("x", 10)]);
        assert_eq!(
            names(&rows),
            ["-begun/y/17/./sub/a.mcap", "+begun/x/17/./sub/a.mcap"]
        );
        let rows = loaded.forget_if(|label, _| label == "./sub/a.mcap");
        assert_eq!(names(&rows), ["-begun/x/17/./sub/a.mcap"]);
        assert_eq!(loaded.held(), 0);
    }

    #[test]
    fn the_file_that_began_earliest_makes_room() {
        let mut begun = Begun::default();
        let size = MOST_BYTES / 2 - 1000;
        begun.keep("late", 30, vec![tail("x", size)]);
        begun.keep("early", 10, vec![tail("x", size)]);
        let rows = begun.keep("middle", 20, vec![tail("x", size)]);
        assert_eq!(names(&rows), ["-begun/x/10/early", "+begun/x/20/middle"]);
        assert!(begun.of("late", Some(30)).is_some() && begun.held() <= MOST_BYTES);
        assert!(
            begun
                .keep("large", 40, vec![tail("x", MOST_BYTES + 1)])
                .is_empty()
        );
        assert_eq!(begun.held(), 2 * size);
    }
}
