//! Judgement of each message: folded, already known, or parked with a reason. It has no connection of its own.

use super::batch::Batch;
use super::centre::{History, Position, SiteState};
use super::incoming::Incoming;
use super::park::Parked;
use super::rows::Rows;
use super::tables::{self, Copied};
use super::text::fit;
use crate::service::forward::message::{self, Label, MessageError};
use crate::site::store::{Change, FORMAT};
use std::collections::{BTreeMap, BTreeSet};

/// Fault of a site of which commits are missing.
pub const GAP: &str = "gap";
/// Fault of a site whose replaced store still sends.
pub const REPLACED: &str = "replaced-store";
/// Fault of a site whose store was set back to a copy and went on from there.
pub const JUMP_BACK: &str = "jump-back";
/// Fault of a site whose message cannot be read.
pub const UNREADABLE: &str = "unreadable";
/// Fault of a site whose store is of a newer format.
pub const NEWER: &str = "newer-format";
/// Fault of a site whose store is of an older format with other columns.
pub const OLDER: &str = "older-format";
/// Fault of a site that is not on the list.
pub const UNLISTED: &str = "unlisted";

/// Longest reason kept \[bytes\].
pub(super) const LONGEST_DETAIL: usize = 500;

/// Result of a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Judged {
    /// Its commits are in the batch, this many new ones.
    Folded(i64),
    /// All its commits were folded before.
    Known,
    /// It was parked, by fault and detail.
    Parked(&'static str, String),
}

/// State of the fold: what is known of each site, ahead of the database by the batch under way.
pub struct Fold {
    listed: BTreeSet<String>,
    rows: Rows,
    sites: BTreeMap<String, SiteState>,
    overruled: BTreeMap<String, i64>,
    /// Stores of sites that went on from a copy.
    set_back: BTreeSet<(String, String)>,
}

impl Fold {
    /// A fold that goes on from what the database knows.
    pub fn new(
        listed: BTreeSet<String>,
        copied: Vec<Copied>,
        sites: BTreeMap<String, SiteState>,
        overruled: BTreeMap<String, i64>,
    ) -> Self {
        Self {
            rows: Rows::of(copied),
            listed,
            sites,
            overruled,
            set_back: BTreeSet::new(),
        }
    }

    /// Folds nothing more of the store of this message, which contradicts what is folded.
    pub fn set_back(&mut self, message: &Incoming) {
        if let Ok(label) = message.label() {
            self.set_back.insert((message.site().to_owned(), label.epoch));
        }
    }

    /// State of each site.
    pub fn sites(&self) -> &BTreeMap<String, SiteState> {
        &self.sites
    }

    /// Goes on from what the database knows, after a batch was not written.
    pub fn again(&mut self, sites: BTreeMap<String, SiteState>) {
        self.sites = sites;
    }

    /// Judges the next message of the stream and adds its effect to the batch.
    pub fn take(&mut self, message: &Incoming, batch: &mut Batch) -> Judged {
        let judged = self.judge(message, batch);
        match &judged {
            Judged::Parked(fault, detail) => self.park(message, fault, detail.clone(), batch),
            Judged::Folded(_) | Judged::Known => Self::pass(message, batch),
        }
        judged
    }

    /// Parks the next message of the stream, and marks its site.
    pub fn park(&mut self, message: &Incoming, fault: &str, detail: String, batch: &mut Batch) {
        Self::pass(message, batch);
        self.set_aside(message.parked(fault, detail), batch);
    }

    /// Parks a message of any stream, and marks its site.
    pub fn set_aside(&mut self, parked: Parked, batch: &mut Batch) {
        let state = self.sites.entry(parked.site.clone()).or_default();
        state.heard_ns = state.heard_ns.max(parked.time_ns);
        // The first fault is the cause; what follows it is its consequence.
        if state.fault.is_none() {
            state.fault = Some((parked.fault.clone(), parked.detail.clone()));
        }
        batch.sites.insert(parked.site.clone(), state.clone());
        batch.parked.push(parked);
    }

    fn pass(message: &Incoming, batch: &mut Batch) {
        batch.position = Some(Position {
            sequence: message.sequence,
            time_ns: message.time_ns,
        });
    }

    /// Folds a message out of turn if it fits; one that does not changes nothing. One that was parked no longer is, once it fits.
    pub fn take_again(&mut self, message: &Incoming, is_parked: bool, batch: &mut Batch) -> Judged {
        let judged = self.judge(message, batch);
        if is_parked && !matches!(judged, Judged::Parked(..)) {
            batch.taken_up.push((message.sequence, message.time_ns));
        }
        judged
    }

    /// Sets the fault of a site, which is that of the first message that is still parked.
    pub fn mark(&mut self, site: &str, fault: Option<(String, String)>, batch: &mut Batch) {
        if let Some(state) = self.sites.get_mut(site)
            && state.fault != fault
        {
            state.fault = fault;
            batch.sites.insert(site.to_owned(), state.clone());
        }
    }

    /// A message's effect, or its fault with a detail that every database and log takes.
    fn judge(&mut self, message: &Incoming, batch: &mut Batch) -> Judged {
        match self.effect(message, batch) {
            Ok(0) => Judged::Known,
            Ok(count) => Judged::Folded(count),
            Err((fault, detail)) => Judged::Parked(fault, fit(&detail, LONGEST_DETAIL)),
        }
    }

    /// Adds the new commits of a message to the batch; returns their number.
    fn effect(&mut self, message: &Incoming, batch: &mut Batch) -> Result<i64, (&'static str, String)> {
        let site = message.site();
        if !self.listed.contains(site) {
            return Err((
                UNLISTED,
                format!("{site} is not on the list of sites that forward"),
            ));
        }
        let label = message.label().map_err(|error| (UNREADABLE, error.to_string()))?;
        let read = || message::decode(&label, &message.payload);
        let came = Position {
            sequence: message.sequence,
            time_ns: message.time_ns,
        };
        self.add((site, &label), came, read, batch)
    }

    /// Adds the new commits of a site's store to the batch; returns their number. `read` gives those of the label.
    ///
    /// # Errors
    /// They do not fit what is known of the site, by fault and detail.
    pub fn add(
        &mut self,
        (site, label): (&str, &Label),
        came: Position,
        read: impl FnOnce() -> Result<Vec<Change>, MessageError>,
        batch: &mut Batch,
    ) -> Result<i64, (&'static str, String)> {
        let mut state = self.sites.get(site).cloned().unwrap_or_default();
        state.heard_ns = state.heard_ns.max(came.time_ns);
        let known = state
            .histories
            .iter()
            .position(|history| history.epoch == label.epoch);
        let overruled = match known.and_then(|place| state.histories.get(place)) {
            // A stream that was set back is read anew: what was folded before the store was replaced comes again.
            Some(history) if known != state.present() && label.last <= history.through => return Ok(0),
            Some(history) => history.overruled,
            None => self
                .overruled
                .get(&tables::overruled(site, &label.epoch))
                .copied(),
        };
        let is_over = match overruled {
            Some(through) => label.last > through,
            None => known.is_some() && known != state.present(),
        };
        if is_over {
            let detail = format!(
                "store {} was replaced by another and still sends: two machines have the name {site}, or an old copy is at work",
                label.epoch
            );
            return Err((REPLACED, detail));
        }
        let changes = read().map_err(|error| match error {
            MessageError::Newer(_) => (NEWER, error.to_string()),
            error => (UNREADABLE, error.to_string()),
        })?;
        if known.is_none() && label.first != 1 {
            let detail = format!(
                "it begins with commit {} of store {}, and none before is here",
                label.first, label.epoch
            );
            return Err((GAP, detail));
        }
        let place = known.unwrap_or_else(|| {
            state.histories.push(History {
                store: state.histories.last().map_or(1, |last| last.store + 1),
                epoch: label.epoch.clone(),
                began_ns: came.time_ns,
                through: 0,
                sequence: 0,
                latest_ns: 0,
                overruled,
            });
            state.histories.len() - 1
        });
        let Some(history) = state.histories.get_mut(place) else {
            return Ok(0);
        };
        let through = history.through;
        if label.first > through + 1 {
            let detail = format!(
                "it begins with commit {} of store {}, and {through} is the last here",
                label.first, label.epoch
            );
            return Err((GAP, detail));
        }
        if label.last > through && self.set_back.contains(&(site.to_owned(), label.epoch.clone())) {
            let detail = format!(
                "store {} was set back to a copy, and commit {} follows one that contradicts what is folded; begin a new store at the site",
                label.epoch, label.first
            );
            return Err((JUMP_BACK, detail));
        }
        // Rows of another format have other checksums.
        let claims = if label.format == FORMAT {
            changes.as_slice()
        } else {
            &[]
        };
        let claims = self.rows.claims(claims, through);
        let claims = claims.map_err(|detail| (UNREADABLE, detail))?;
        let rows = self.rows.check(&changes, through);
        let rows = rows.map_err(|detail| {
            if label.format == FORMAT {
                return (UNREADABLE, detail);
            }
            let detail = format!(
                "it is of store format {}, and this program writes {FORMAT}: update the site, and have it send again from commit {} \
                 (resend); {detail}",
                label.format, label.first
            );
            (OLDER, detail)
        })?;
        if label.last > through {
            history.through = label.last;
            history.sequence = came.sequence;
        }
        for row in &rows {
            history.latest_ns = history
                .latest_ns
                .max(row.begin_of_record(&self.rows).unwrap_or(0));
        }
        for row in rows {
            row.put(&self.rows, batch, (site, history.store));
        }
        for (table, claim) in claims {
            batch.claim(table, (site, history.store), claim);
        }
        batch.sites.insert(site.to_owned(), state.clone());
        self.sites.insert(site.to_owned(), state);
        Ok((label.last - through).max(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::record::{RodId, Timestamp};
    use crate::service::hub::centre::CentreError;
    use crate::service::hub::post::{self, Post, SITES, store};
    use crate::service::hub::sql::SqlError;
    use crate::site::store::{Asked, ConditionEvent, Store};

    #[test]
    fn a_repeated_message_adds_nothing_and_an_overlapping_one_its_end() {
        let (mut post, store) = (Post::new(), store());
        let first = post.of("todi", &store, 1, 3);
        assert_eq!(post.send(&first), Judged::Folded(3));
        assert_eq!(post.send(&first), Judged::Known);
        let overlapping = post.of("todi", &store, 2, 6);
        assert_eq!(post.send(&overlapping), Judged::Folded(3));
        assert_eq!(post.rows("notice", "todi", 1), 5);
        assert_eq!(post.centre.position().unwrap().sequence, 2);
        // What the hub knows after a crash is what it has written.
        let before = post.fold.sites().clone();
        post.again(&SITES);
        assert_eq!(*post.fold.sites(), before);
        assert!(post.folder.path().exists());
    }

    #[test]
    fn commits_that_come_again_with_another_content_are_refused_and_what_follows_them_is_parked() {
        let (mut post, store) = (Post::new(), store());
        let whole = post.of("todi", &store, 1, 6);
        post.send(&whole);
        // The copy has the first five of them, and went on otherwise.
        let mut changes = store.changes_after(0, 5).unwrap();
        let mut copy = Store::in_memory().unwrap();
        for at in 0..7 {
            let begun = ConditionEvent::raised("sink", "mail", Timestamp::from_nanos(at), "out of reach");
            copy.watch(&[begun], None).unwrap();
        }
        changes.extend(copy.changes_after(5, 2).unwrap());
        let epoch = store.epoch().unwrap().unwrap();
        let equal = post.with("todi", &epoch, 1, 5, &changes[..5]);
        assert_eq!(post.send(&equal), Judged::Known);
        for first in [1, 6] {
            let again = post.with("todi", &epoch, first, 6, &changes[first as usize - 1..6]);
            let mut batch = Batch::default();
            assert_eq!(post.fold.take(&again, &mut batch), Judged::Known);
            let refused = post.centre.commit(batch);
            assert!(
                matches!(refused, Err(CentreError::Sql(SqlError::Contradiction(_)))),
                "{refused:?}"
            );
            post.fold.set_back(&again);
        }
        let after = post.with("todi", &epoch, 7, 7, &changes[6..]);
        assert!(matches!(post.send(&after), Judged::Parked(JUMP_BACK, _)));
        // A store begun anew is another history.
        let new = post::store();
        let new = post.of("todi", &new, 1, 6);
        assert_eq!(post.send(&new), Judged::Folded(6));
    }

    #[test]
    fn a_gap_is_parked_and_closes_by_itself_and_the_others_go_on() {
        let (mut post, store) = (Post::new(), store());
        let messages =
            [(1, 1), (2, 3), (4, 5), (6, 6)].map(|(first, last)| post.of("todi", &store, first, last));
        post.send(&messages[0]);
        for late in [&messages[2], &messages[3]] {
            assert!(matches!(post.send(late), Judged::Parked(GAP, _)));
        }
        assert_eq!(post.fault("todi").as_deref(), Some(GAP));
        let other = post.of("gubbio", &store, 1, 6);
        assert_eq!(post.send(&other), Judged::Folded(6));
        assert_eq!(post.fault("gubbio"), None);
        assert_eq!(post.send(&messages[1]), Judged::Folded(2));
        assert_eq!(post.take_up("todi"), 2);
        assert_eq!(post.fault("todi"), None);
        assert_eq!(
            (post.rows("notice", "todi", 1), post.rows("notice", "gubbio", 1)),
            (5, 5)
        );
        assert!(post.parked("todi").is_empty());
    }

    #[test]
    fn a_replaced_store_is_a_history_of_its_own_and_the_old_one_may_not_go_on() {
        let (mut post, old, new) = (Post::new(), store(), store());
        let begun = post.of("todi", &old, 1, 4);
        post.send(&begun);
        // A history that does not begin at its beginning is none.
        let late = post.of("todi", &new, 2, 6);
        assert!(matches!(post.send(&late), Judged::Parked(GAP, _)));
        let whole = post.of("todi", &new, 1, 6);
        assert_eq!(post.send(&whole), Judged::Folded(6));
        assert_eq!(post.take_up("todi"), 1);
        assert_eq!(
            (post.rows("notice", "todi", 1), post.rows("notice", "todi", 2)),
            (3, 5)
        );
        let after = post.of("todi", &old, 5, 6);
        assert!(matches!(post.send(&after), Judged::Parked(REPLACED, _)));
        assert_eq!(post.rows("notice", "todi", 1), 3);
        // A stream that was set back is read from its beginning: what is known is no fault.
        post.centre.discard("todi").unwrap();
        post.again(&SITES);
        for known in [&begun, &whole] {
            assert_eq!(post.send(known), Judged::Known);
        }
        assert_eq!((post.fault("todi"), post.parked("todi").len()), (None, 0));
    }

    #[test]
    fn an_operator_says_which_of_two_stores_is_the_present_one_and_a_rebuild_keeps_to_it() {
        let (mut post, right, wrong) = (Post::new(), store(), store());
        let messages = [
            post.of("todi", &right, 1, 3),
            post.of("todi", &wrong, 1, 4),
            post.of("todi", &right, 4, 5),
            post.of("todi", &wrong, 5, 6),
            post.of("todi", &right, 6, 6),
        ];
        for message in &messages[..3] {
            post.send(message);
        }
        assert_eq!(post.fault("todi").as_deref(), Some(REPLACED));
        let epoch = right.epoch().unwrap().unwrap();
        assert!(post.centre.make_present("todi", "nothing").is_err());
        post.centre.make_present("todi", &epoch).unwrap();
        let rows = |post: &mut Post| (post.rows("notice", "todi", 1), post.rows("notice", "todi", 2));
        post.again(&SITES);
        assert_eq!(post.take_up("todi"), 1);
        assert_eq!(post.fault("todi"), None);
        assert!(matches!(post.send(&messages[3]), Judged::Parked(REPLACED, _)));
        assert_eq!(post.send(&messages[4]), Judged::Folded(1));
        let state = post.fold.sites()["todi"].clone();
        assert_eq!(
            (state.history().unwrap().store, state.history().unwrap().through),
            (1, 6)
        );
        assert_eq!(rows(&mut post), (5, 3));
        post.centre.clear().unwrap();
        post.again(&SITES);
        for message in &messages {
            post.send(message);
        }
        assert_eq!(rows(&mut post), (5, 3));
        assert_eq!(post.parked("todi").len(), 1);
        // A word that is taken back.
        let other = wrong.epoch().unwrap().unwrap();
        post.centre.make_present("todi", &other).unwrap();
        post.again(&SITES);
        assert_eq!(post.take_up("todi"), 1);
        assert_eq!(rows(&mut post), (5, 5));
    }

    #[test]
    fn a_removed_rod_is_removed_from_batch_and_database() {
        let mut post = Post::new();
        let mut store = store();
        let asked = Asked::Rebaseline { reason: None };
        let rod = RodId("r".to_owned());
        store.request(&rod, &asked, Timestamp::from_nanos(1)).unwrap();
        store.forget_rod(&rod).unwrap();
        let message = post.of("todi", &store, 1, 7);
        assert_eq!(post.send(&message), Judged::Folded(7));
        assert_eq!(post.rows("rod", "todi", 1), 0);
    }
}
