//! Rebuild of the centre from the stream alone, which first shows that nothing would be lost.

use super::batch::Batch;
use super::centre::{Centre, SiteState};
use super::feed::{Feed, number};
use super::fold::Fold;
use super::incoming::Incoming;
use super::work::Work;
use super::{Hub, HubError};
use crate::service::alert::{Backoff, Pace};
use std::collections::BTreeMap;
use std::thread;

/// Most threads that fold without a database.
const MOST_SHARES: usize = 8;

/// Number of lines by site and store.
type Lines = BTreeMap<(String, i64), i64>;

impl Hub<'_> {
    /// Empties the database and folds the whole stream; returns the number of its last message.
    ///
    /// # Errors
    /// The stream no longer has all that the database has, or something fails: then it is run again.
    pub fn rebuild(&self) -> Result<u64, HubError> {
        let mut centre = super::open(&self.config.storage)?;
        let mut feed = self.runtime.block_on(Feed::open(self.config))?;
        let (_, last) = self.runtime.block_on(feed.bounds())?;
        self.check_nothing_is_lost(&mut centre, &mut feed, last)?;
        centre.clear()?;
        drop((centre, feed));
        Work::open(self)?.run(&mut Backoff::new(Pace::default(), 1), Some(last))?;
        Ok(last)
    }

    /// Folds the stream without a database, and compares what would come of it with what is there.
    fn check_nothing_is_lost(&self, centre: &mut Centre, feed: &mut Feed, last: u64) -> Result<(), HubError> {
        let known = centre.sites()?;
        let lost = |site: &str, what: String| Err(HubError::Lost(site.to_owned(), what));
        let listed = self.listed();
        for (site, state) in &known {
            if !state.histories.is_empty() && self.config.is_thin(site) {
                return lost(
                    site,
                    "a worker wrote them, and the stream does not have them".to_owned(),
                );
            }
            if !state.histories.is_empty() && !listed.contains(site) {
                return lost(site, "it is not on the list of sites".to_owned());
            }
        }
        if known.values().all(|state| state.histories.is_empty()) {
            return Ok(());
        }
        let copied = centre.copied().to_vec();
        let of_lines = copied.iter().position(|copied| copied.shape.table == "line");
        let overruled = centre.overruled()?;
        let count = thread::available_parallelism()
            .map_or(1, usize::from)
            .min(MOST_SHARES);
        let share = || Share {
            fold: Fold::new(listed.clone(), copied.clone(), BTreeMap::new(), overruled.clone()),
            lines: Lines::new(),
        };
        let mut shares: Vec<Share> = (0..count).map(|_| share()).collect();
        feed.seek(1);
        let mut position = 0;
        while position < last {
            let messages = self.runtime.block_on(feed.fetch())?;
            let Some(end) = messages.last() else { break };
            position = number(end);
            thread::scope(|scope| {
                for (number, share) in shares.iter_mut().enumerate() {
                    let of_share = messages
                        .iter()
                        .filter(move |message| place_of(message.site(), count) == number);
                    scope.spawn(move || share.take(of_share, of_lines));
                }
            });
        }
        let there = centre.counts("line")?;
        for (site, state) in &known {
            let share = &shares[place_of(site, count)];
            let found = share.fold.sites().get(site).cloned().unwrap_or_default();
            if let Some(what) = missing(site, state, &there, &found, &share.lines) {
                return lost(site, what);
            }
        }
        Ok(())
    }
}

/// Sites of one thread, folded without a database.
struct Share {
    fold: Fold,
    lines: Lines,
}

impl Share {
    fn take<'m>(&mut self, messages: impl Iterator<Item = &'m Incoming>, of_lines: Option<usize>) {
        let mut batch = Batch::default();
        for message in messages {
            self.fold.take(message, &mut batch);
            if batch.is_full() {
                self.count(&std::mem::take(&mut batch), of_lines);
            }
        }
        self.count(&batch, of_lines);
    }

    fn count(&mut self, batch: &Batch, of_lines: Option<usize>) {
        for (place, more) in of_lines.map(|table| batch.count(table)).unwrap_or_default() {
            *self.lines.entry(place).or_default() += more;
        }
    }
}

/// Number of the share of a site, of so many.
fn place_of(site: &str, count: usize) -> usize {
    site.bytes().map(usize::from).sum::<usize>() % count.max(1)
}

/// Results of a site's histories that another state of it lacks, in words.
fn missing(site: &str, known: &SiteState, there: &Lines, found: &SiteState, lines: &Lines) -> Option<String> {
    for history in &known.histories {
        let (epoch, through) = (&history.epoch, history.through);
        let Some(again) = found.histories.iter().find(|again| again.epoch == *epoch) else {
            return Some(format!("the stream does not have the beginning of store {epoch}"));
        };
        if again.through < through {
            return Some(format!(
                "of store {epoch} the stream gives commits 1 to {}, and the database has {through}",
                again.through
            ));
        }
        let of = |lines: &Lines, store: i64| lines.get(&(site.to_owned(), store)).copied().unwrap_or(0);
        let (before, after) = (of(there, history.store), of(lines, again.store));
        if after < before {
            return Some(format!(
                "of store {epoch} the stream has {after} result lines, and the database {before}: the site had removed the others \
                 when it sent again"
            ));
        }
    }
    None
}
