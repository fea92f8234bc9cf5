//! Finished files whose rods' thermometers write files of their own: each waits until the readings for it have come, or a while.

use super::lane::Stamp;
use crate::analysis::signal::record::{RodChannels, RodId, STALE_S};
use crate::recording::read::folder::Span;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ffi::{OsStr, OsString};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Finished files that are not queued yet.
#[derive(Default)]
pub(super) struct Awaiting {
    files: BTreeMap<OsString, Waiting>,
    heard: Heard,
}

/// Readings that came so far.
#[derive(Default)]
struct Heard {
    /// Log time up to which the files so far have readings, by topic \[ns since 1970\].
    reached: HashMap<String, u64>,
    /// Rods that had readings in a file without their samples.
    apart: BTreeSet<RodId>,
    /// Time of the latest file whose topics were not known: readings may have come in it.
    unsure: Option<Instant>,
}

/// A file that waits.
pub(super) struct Waiting {
    /// Log time of its first message \[ns since 1970\].
    pub begins: u64,
    /// Its size and time of change.
    pub stamp: Stamp,
    /// `None` if its topics are not known.
    span: Option<Span>,
    since: Instant,
    /// Time for which it had waited before that.
    waited: Duration,
    is_told: bool,
}

/// A file that begins to wait.
pub(super) struct News {
    pub file: OsString,
    pub topics: Vec<String>,
}

impl Awaiting {
    /// None yet; rods that are `apart` had readings in a file without their samples before.
    pub(super) fn new(apart: BTreeSet<RodId>) -> Self {
        let heard = Heard {
            apart,
            ..Heard::default()
        };
        Self {
            files: BTreeMap::new(),
            heard,
        }
    }

    /// True if a file waits as it is now.
    pub(super) fn has(&self, name: &OsStr, stamp: &Stamp) -> bool {
        self.files.get(name).is_some_and(|file| file.stamp == *stamp)
    }

    /// True if a file that waits has samples of a rod.
    pub(super) fn has_samples_of(&self, rod: &RodId, channels: &[RodChannels]) -> bool {
        let rod = channels.iter().find(|own| own.rod == *rod);
        let mut spans = self.files.values().filter_map(|file| file.span.as_ref());
        rod.is_some_and(|rod| spans.any(|span| has_samples(span, rod)))
    }

    /// Adds a file that has waited for so long already. Beside one whose topics are not known none waits, nor for as long behind it.
    pub(super) fn add(
        &mut self,
        name: &OsStr,
        (begins, stamp): (u64, Stamp),
        span: Option<Span>,
        waited: Duration,
    ) {
        if span.is_none() {
            self.heard.unsure = Some(Instant::now());
        }
        let before = self.files.remove(name);
        let (since, waited, is_told) = match before {
            Some(before) => (before.since, before.waited, before.is_told),
            None => (Instant::now(), waited, false),
        };
        let waiting = Waiting {
            begins,
            stamp,
            span,
            since,
            waited,
            is_told,
        };
        self.files.insert(name.to_owned(), waiting);
    }

    /// Removes a file that is not to be read as a finished one.
    pub(super) fn remove(&mut self, name: &OsStr) {
        self.files.remove(name);
    }

    /// Takes out the files that wait no longer: a file had readings up to [`STALE_S`] before their end, they have waited for `most`, or one
    /// that grows began after them. Those that begin to wait come second. Files that are gone are forgotten.
    pub(super) fn due(
        &mut self,
        channels: &[RodChannels],
        is_there: impl Fn(&OsString) -> bool,
        (most, growing_from): (Duration, Option<u64>),
    ) -> (Vec<(OsString, Waiting)>, Vec<News>) {
        self.files.retain(|name, _| is_there(name));
        let Self { files, heard } = self;
        heard.take(files.values().filter_map(|file| file.span.as_ref()), channels);
        let mut news = Vec::new();
        let due = files.extract_if(.., |name, file| {
            let topics = heard.missing(file, channels, most);
            let is_over = file.since.elapsed() + file.waited >= most
                || growing_from.is_some_and(|from| file.begins <= from);
            if topics.is_empty() || is_over {
                return true;
            }
            if !std::mem::replace(&mut file.is_told, true) {
                news.push(News {
                    file: name.clone(),
                    topics,
                });
            }
            false
        });
        (due.collect(), news)
    }
}

fn has_samples(span: &Span, rod: &RodChannels) -> bool {
    rod.sensors().any(|channel| span.topics.contains(&channel.topic))
}

impl Heard {
    /// Takes the readings of files.
    fn take<'s>(&mut self, spans: impl Iterator<Item = &'s Span>, channels: &[RodChannels]) {
        // What a wrong clock stamped says nothing of the files to come.
        let latest = SystemTime::now() + Duration::from_secs(86_400);
        let latest = latest
            .duration_since(UNIX_EPOCH)
            .map_or(u64::MAX, |since| since.as_nanos() as u64);
        for span in spans.filter(|span| span.to <= latest) {
            for rod in channels {
                let topic = rod.temperature.as_ref().map(|channel| &channel.topic);
                let Some(topic) = topic.filter(|topic| span.topics.contains(*topic)) else {
                    continue;
                };
                let reached = self.reached.entry(topic.clone()).or_default();
                *reached = span.to.max(*reached);
                if !has_samples(span, rod) {
                    self.apart.insert(rod.rod.clone());
                }
            }
        }
    }

    /// Topics of thermometers whose readings for a file's samples are missing so far, if these come in files of their own.
    fn missing(&self, file: &Waiting, channels: &[RodChannels], most: Duration) -> Vec<String> {
        let is_unsure = self.unsure.is_some_and(|since| since.elapsed() < most);
        let Some(span) = file.span.as_ref().filter(|_| !is_unsure) else {
            return Vec::new();
        };
        let wanted = span.to.saturating_sub(STALE_S as u64 * 1_000_000_000);
        let of_rod = |rod: &RodChannels| {
            let topic = &rod.temperature.as_ref()?.topic;
            let is_reached = self.reached.get(topic).is_some_and(|to| *to >= wanted);
            let is_there = is_reached || span.topics.contains(topic);
            (!is_there && self.apart.contains(&rod.rod) && has_samples(span, rod)).then(|| topic.clone())
        };
        let topics: BTreeSet<String> = channels.iter().filter_map(of_rod).collect();
        topics.into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    const SECOND: u64 = 1_000_000_000;
    const MOST: Duration = Duration::from_secs(3600);

    fn channels() -> Vec<RodChannels> {
        let text =
            std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/campaign.toml")).unwrap();
        let config = Config::parse(&text, "campaign.toml").unwrap();
        config.rods.iter().map(|rod| rod.channels.clone()).collect()
    }

    /// A file with these topics from one second to another, that has waited for some.
    fn add(files: &mut Awaiting, name: &str, topics: &[&str], [from, to]: [u64; 2], waited_s: u64) {
        let span = Span {
            from: from * SECOND,
            to: to * SECOND,
            topics: topics.iter().map(|topic| (*topic).to_owned()).collect(),
        };
        let waited = Duration::from_secs(waited_s);
        files.add(OsStr::new(name), (from * SECOND, (1, 1)), Some(span), waited);
    }

    /// Names of those that are due, and of those that begin to wait.
    fn due(files: &mut Awaiting) -> String {
        due_beside(files, None)
    }

    fn due_beside(files: &mut Awaiting, growing_from: Option<u64>) -> String {
        let (due, news) = files.due(
            &channels(),
            |_| true,
            (MOST, growing_from.map(|second| second * SECOND)),
        );
        let names = due.iter().map(|(name, _)| name.to_str().unwrap().to_owned());
        let news = news
            .iter()
            .map(|news| format!("{} for {}", news.file.display(), news.topics.join(" ")));
        names.chain(news).collect::<Vec<_>>().join(", ")
    }

    #[test]
    fn samples_wait_for_readings_that_come_in_other_files() {
        let (rod, air) = ("/nave-3/displacement", "/nave/air");
        let mut files = Awaiting::default();
        // Nothing came of the thermometer, or with the samples alone.
        add(&mut files, "first", &[rod, air], [0, 120], 0);
        add(&mut files, "without", &[rod], [5_000, 5_120], 0);
        assert_eq!(due(&mut files), "first, without");
        add(&mut files, "second", &[rod], [10_000, 10_120], 0);
        add(&mut files, "air", &[air, "/other"], [0, 9_000], 0);
        assert_eq!(due(&mut files), "air, second for /nave/air");
        let id = &channels()[0].rod;
        assert!(
            files.has_samples_of(id, &channels()) && !files.has_samples_of(&RodId::from("b"), &channels())
        );
        assert_eq!(due(&mut files), "");
        // A file with both waits for nothing, and its readings are those of the others, too.
        add(&mut files, "both", &[rod, air], [9_100, 9_300], 0);
        assert_eq!(due(&mut files), "both, second");
        // A clock in the future says nothing.
        add(&mut files, "wrong", &[air], [9_100, 9_000_000_000], 0);
        add(&mut files, "gone", &[rod], [20_000, 20_120], 0);
        assert_eq!(due(&mut files), "wrong, gone for /nave/air");
        assert!(files.due(&channels(), |_| false, (MOST, None)).0.is_empty());
        assert_eq!(due(&mut files), "");
        // Those that have waited for long enough, and those that a growing one may go on with.
        add(&mut files, "old", &[rod], [20_000, 20_120], 3600);
        add(&mut files, "elder", &[rod], [30_000, 30_120], 3599);
        add(&mut files, "younger", &[rod], [40_000, 40_120], 0);
        assert_eq!(
            due_beside(&mut files, Some(29_999)),
            "old, elder for /nave/air, younger for /nave/air"
        );
        // Written to while it waits, it does not wait anew.
        add(&mut files, "younger", &[rod], [40_000, 40_150], 0);
        assert_eq!(due_beside(&mut files, Some(30_000)), "elder");
        files.remove(OsStr::new("younger"));
        assert!(files.files.is_empty());
    }

    #[test]
    fn a_thermometer_that_came_before_the_start_is_waited_for() {
        let mut files = Awaiting::new(BTreeSet::from([channels()[0].rod.clone()]));
        add(&mut files, "first", &["/nave-3/displacement"], [0, 120], 0);
        assert_eq!(due(&mut files), "first for /nave/air");
        files.add(OsStr::new("unknown"), (0, (1, 1)), None, Duration::ZERO);
        assert_eq!(due(&mut files), "first, unknown");
        add(&mut files, "second", &["/nave-3/displacement"], [0, 120], 0);
        assert_eq!(due(&mut files), "second");
        files.heard.unsure = Instant::now().checked_sub(MOST);
        add(&mut files, "third", &["/nave-3/displacement"], [0, 120], 0);
        assert_eq!(due(&mut files), "third for /nave/air");
    }
}
