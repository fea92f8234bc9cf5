//! Records of recordings and other programs' files, in the order in which a replay takes them.

use crate::analysis::signal::record::{Event, RecordSettings, RodChannels};
use crate::analysis::track::ordered::Ordered;
use crate::config::Config;
use crate::recording::import::{self, How, Whose};
use crate::recording::read::folder::{Span, first_time};
use crate::recording::read::recordings::FileResult;
use crate::recording::read::{self, Opener, Options, Recording, Recordings, SourceError, Step};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Wraps a file, whose length is given, while it is read.
pub type Watch = fn(File, u64) -> Box<dyn Read>;

/// Options for other programs' files among the recordings.
#[derive(Debug, Clone, Default)]
pub struct Others {
    /// Options for reading them.
    pub how: How,
    /// True if the configuration was named for them.
    pub is_meant: bool,
    /// True if one without a start is accepted.
    pub any_start: bool,
    /// True if a recording that the file system refuses ends the run: what comes after it must not be taken before it.
    pub needs_all: bool,
}

/// Records of a campaign: an iterator over the events of its files in the order of event time.
pub struct Records {
    input: Recordings,
    order: Ordered<Event>,
    files: Vec<FileResult>,
}

impl Records {
    /// Opens files, or folders of them, for the rods of a configuration.
    pub fn open(paths: &[PathBuf], config: &Config, others: Others) -> Self {
        let files = in_order(read::recordings(paths), &others.how);
        let channels: Vec<RodChannels> = config.rods.iter().map(|rod| rod.channels.clone()).collect();
        let opener = AnyFile::new(others, channels.clone(), config.record, |file, _| Box::new(file));
        let input = Recordings::new(files, channels, config.record, false, Default::default());
        Self {
            input: input.opened_by(opener),
            order: Ordered::new(config.track.reorder_window_s),
            files: Vec::new(),
        }
    }

    /// Takes the results of the files read to their end since the last call.
    pub fn files(&mut self) -> Vec<FileResult> {
        std::mem::take(&mut self.files)
    }
}

impl Iterator for Records {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        loop {
            if let Some(event) = self.order.next_settled() {
                return Some(event);
            }
            match self.input.next() {
                Some(Step::Event(event, place)) => {
                    self.order.note(&place.reached);
                    self.order.push(&event.rod().clone(), place.at, event);
                }
                Some(Step::File(result)) => self.files.push(result),
                Some(Step::More | Step::Wait | Step::End) => {}
                None => return self.order.next_of_all(),
            }
        }
    }
}

/// Sorts other programs' files among the recordings by the time of their first sample; those without a start
/// stay last.
pub fn in_order(files: Vec<Result<PathBuf, SourceError>>, how: &How) -> Vec<Result<PathBuf, SourceError>> {
    if files.len() < 2 {
        return files;
    }
    let first = |path: &PathBuf| {
        let recorded = File::open(path).ok().and_then(|file| first_time(&file));
        let time = || Some(import::begins(path, how)?.as_nanos());
        recorded
            .or_else(|| u64::try_from(time()?).ok())
            .unwrap_or(u64::MAX)
    };
    let mut timed: Vec<_> = files
        .into_iter()
        .map(|file| (file.as_ref().map_or(0, first), file))
        .collect();
    timed.sort_by_key(|(time, _)| *time);
    timed.into_iter().map(|(_, file)| file).collect()
}

/// Opens recordings and other programs' files for configured rods.
pub struct AnyFile {
    others: Others,
    rods: Vec<RodChannels>,
    settings: RecordSettings,
    watch: Watch,
}

impl AnyFile {
    /// With the options for other programs' files.
    pub fn new(others: Others, rods: Vec<RodChannels>, settings: RecordSettings, watch: Watch) -> Self {
        Self {
            others,
            rods,
            settings,
            watch,
        }
    }

    fn whose(&self) -> Whose<'_> {
        Whose {
            rods: &self.rods,
            is_meant: self.others.is_meant,
            any_start: self.others.any_start,
        }
    }
}

impl Opener for AnyFile {
    fn open(&self, path: &Path, options: &Options) -> Result<Recording, SourceError> {
        let (how, settings) = (&self.others.how, &self.settings);
        import::open(path, how, self.whose(), settings, options.clone(), &self.watch)
    }

    fn span(&self, path: &Path) -> Option<Span> {
        import::span(path, &self.others.how, self.whose())
    }
}
