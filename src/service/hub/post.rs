//! Messages of a stream made by hand, and the centre they are folded into: for the tests beside this.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use super::batch::Batch;
use super::centre::Centre;
use super::fold::{Fold, Judged};
use super::incoming::Incoming;
use super::park::Parked;
use super::sqlite::Sqlite;
use crate::analysis::signal::record::Timestamp;
use crate::service::forward::message::{self, Label, OUT};
use crate::site::store::{Change, ConditionEvent, FORMAT, Store};
use std::collections::{BTreeMap, BTreeSet};

/// A store with some commits.
pub fn store() -> Store {
    let mut store = Store::in_memory().unwrap();
    store.keep_config("a", "tower", "text").unwrap();
    for day in 0..5 {
        let begun = ConditionEvent::raised("sink", "mail", Timestamp::from_nanos(1 + day), "refused");
        store.watch(&[begun], None).unwrap();
    }
    store
}

/// A stream made by hand, folded into a file.
pub struct Post {
    pub folder: tempfile::TempDir,
    pub centre: Centre,
    pub fold: Fold,
    pub sequence: i64,
}

pub const SITES: [&str; 2] = ["todi", "gubbio"];

impl Post {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut post = Self {
            centre: Centre::open(Box::new(Sqlite::open(&folder.path().join("centre.db")).unwrap())).unwrap(),
            fold: Fold::new(BTreeSet::new(), Vec::new(), BTreeMap::new(), BTreeMap::new()),
            folder,
            sequence: 0,
        };
        post.again(&SITES);
        post
    }

    /// A hub started anew with these sites on its list.
    pub fn again(&mut self, listed: &[&str]) {
        let listed = listed.iter().map(|site| (*site).to_owned()).collect();
        let copied = self.centre.copied().to_vec();
        let (sites, overruled) = (self.centre.sites().unwrap(), self.centre.overruled().unwrap());
        self.fold = Fold::new(listed, copied, sites, overruled);
    }

    pub fn send(&mut self, message: &Incoming) -> Judged {
        let mut batch = Batch::default();
        let judged = self.fold.take(message, &mut batch);
        self.centre.commit(batch).unwrap();
        judged
    }

    pub fn take_up(&mut self, site: &str) -> usize {
        let mut batch = Batch::default();
        let mut taken = 0;
        for parked in self.parked(site) {
            let judged = self
                .fold
                .take_again(&Incoming::of_parked(parked), true, &mut batch);
            taken += usize::from(!matches!(judged, Judged::Parked(..)));
        }
        self.centre.commit(batch).unwrap();
        let mut batch = Batch::default();
        let first = self.centre.first_fault(site).unwrap();
        self.fold.mark(site, first, &mut batch);
        self.centre.commit(batch).unwrap();
        taken
    }

    pub fn parked(&mut self, site: &str) -> Vec<Parked> {
        self.centre.parked(site, None, (i64::MIN, i64::MIN)).unwrap()
    }

    pub fn of(&mut self, site: &str, store: &Store, first: i64, last: i64) -> Incoming {
        let changes = store
            .changes_after(first - 1, (last - first + 1) as usize)
            .unwrap();
        self.with(site, &store.epoch().unwrap().unwrap(), first, last, &changes)
    }

    pub fn with(&mut self, site: &str, epoch: &str, first: i64, last: i64, changes: &[Change]) -> Incoming {
        self.sequence += 1;
        let label = Label {
            epoch: epoch.to_owned(),
            first,
            last,
            format: FORMAT,
            mark: String::new(),
        };
        let headers: Vec<String> = label
            .headers(0)
            .iter()
            .map(|(name, values)| format!("{name}: {}", values[0]))
            .collect();
        Incoming {
            sequence: self.sequence,
            subject: format!("{OUT}.{site}"),
            headers: headers.join("\n"),
            payload: message::encode(changes).unwrap(),
            time_ns: 1_000 * self.sequence,
        }
    }

    pub fn rows(&mut self, table: &str, site: &str, store: i64) -> usize {
        let copied = self.centre.copied().to_vec();
        let copied = copied.iter().find(|copied| copied.shape.table == table).unwrap();
        self.centre.rows_of(copied, site, store).unwrap().len()
    }

    pub fn fault(&self, site: &str) -> Option<String> {
        self.fold.sites().get(site)?.fault.clone().map(|(fault, _)| fault)
    }
}
