//! The TOML configuration: every fault reported at once, with its key and line.
//!
//! A new section is one `read` function that takes its keys from a `reader::Table`, one line in
//! `Config::read`, and its keys in `docs/configuration.md` (a test compares the two).

mod abc;
mod alarm;
#[cfg(feature = "daemon")]
mod bucket;
mod channel;
pub mod datum;
mod effective;
mod emulator;
mod fault;
#[cfg(feature = "daemon")]
mod forward;
mod http;
#[cfg(feature = "daemon")]
mod hub;
mod ingest;
mod journal;
mod list;
mod modes;
mod prior;
mod range;
mod reader;
mod record;
mod rod;
mod sensor;
mod setting;
pub mod settings;
mod simulation;
#[cfg(feature = "daemon")]
mod sink;
mod site;
mod spectrum;
mod store;
mod suggestion;
mod take;
mod test;
mod track;
pub mod unheard;
pub mod units;
mod value;
pub mod within;
pub mod written;

pub use effective::KeyReference;
pub use fault::{ConfigError, Fault};
#[cfg(feature = "daemon")]
pub use hub::HubConfig;
pub use rod::rod_id;
pub use setting::Setting;
pub use simulation::SimulationConfig;
pub use suggestion::nearest;

use crate::analysis::identify::AnalysisSettings;
use crate::analysis::signal::record::{RecordSettings, RodChannels, RodId};
use crate::analysis::track::{AlarmSettings, TrackSettings};
#[cfg(feature = "daemon")]
use crate::config::settings::alert::{AlertSettings, SinkSettings};
#[cfg(feature = "daemon")]
use crate::config::settings::bucket::BucketSettings;
#[cfg(feature = "daemon")]
use crate::config::settings::forward::ForwardSettings;
use crate::config::settings::http::HttpSettings;
use crate::config::settings::ingest::IngestSettings;
use crate::config::settings::journal::JournalSettings;
use crate::config::settings::store::StoreSettings;

use fault::Faults;
use reader::Table;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use toml::de::DeTable;

/// Longest configuration read \[bytes\].
pub const LONGEST: usize = 1 << 20;

/// Sections that no result depends on.
const OPERATION: [&str; 8] = [
    "simulation",
    "ingest",
    "journal",
    "http",
    "sink",
    "alert",
    "forward",
    "bucket",
];

const BUILT_IN: &str = include_str!("../../config/todi.toml");

/// Configuration of a site: everything a run depends on besides its data.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Name of the site.
    pub site: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// The rods, at least one, with different ids.
    pub rods: Vec<RodConfig>,
    /// Settings of cutting samples into records and of refusing records.
    pub record: RecordSettings,
    /// Settings of tracking the relative force.
    pub track: TrackSettings,
    /// Settings of the alarms.
    pub alarm: AlarmSettings,
    /// Settings of the store.
    pub store: StoreSettings,
    /// Sources of live data.
    pub ingest: IngestSettings,
    /// Settings of the journal of live data.
    pub journal: JournalSettings,
    /// Settings of the daemon's HTTP server.
    pub http: HttpSettings,
    /// Destinations of alarms.
    #[cfg(feature = "daemon")]
    pub sinks: Vec<SinkSettings>,
    /// Settings of messages about the daemon itself.
    #[cfg(feature = "daemon")]
    pub alert: AlertSettings,
    /// Copy of the results to a centre; `None` without a `[forward]`.
    #[cfg(feature = "daemon")]
    pub forward: Option<ForwardSettings>,
    /// Copy of the journal's parts to object storage; `None` without a `[bucket]`.
    #[cfg(feature = "daemon")]
    pub bucket: Option<BucketSettings>,
    /// Simulation that `simulate` writes; `None` without a `[simulation]`.
    pub simulation: Option<SimulationConfig>,
    effective: effective::Node,
}

/// One rod: settings of its analysis, and channels of its samples.
#[derive(Debug, Clone, PartialEq)]
pub struct RodConfig {
    /// Settings of its analysis.
    pub analysis: AnalysisSettings,
    /// Location of its samples in a recording.
    pub channels: RodChannels,
}

impl Config {
    /// Configuration built into the program: the paper's rod (`config/todi.toml`).
    pub fn built_in() -> Self {
        match Self::parse(BUILT_IN, "config/todi.toml") {
            Ok(config) => config,
            Err(error) => unreachable!("the built-in configuration is tested: {error}"),
        }
    }

    /// Reads and validates a file of at most [`LONGEST`] bytes.
    ///
    /// # Errors
    /// The file cannot be read, or its faults, all of them.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = read_text(path)?;
        Self::parse(&text, &path.display().to_string())
    }

    /// Resolves a command's configuration: the file at `path` or else the built-in one, overridden by
    /// settings of the command line. They are validated as if the file held them, and they are part of the
    /// hash.
    ///
    /// # Errors
    /// The file cannot be read, or the faults of file and settings, all of them.
    pub fn resolve(path: Option<&Path>, settings: &[Setting]) -> Result<Self, ConfigError> {
        match path {
            Some(path) => Self::parse_with(&read_text(path)?, &path.display().to_string(), settings),
            None => Self::parse_with(BUILT_IN, "config/todi.toml", settings),
        }
    }

    /// Reads and validates a text called `origin` in messages.
    ///
    /// # Errors
    /// Its faults, all of them, in the order of the text.
    pub fn parse(text: &str, origin: &str) -> Result<Self, ConfigError> {
        Self::parse_with(text, origin, &[])
    }

    fn parse_with(text: &str, origin: &str, settings: &[Setting]) -> Result<Self, ConfigError> {
        let (config, effective) = parse_tables(text, origin, settings, "config/minimal.toml", Self::read)?;
        Ok(Self { effective, ..config })
    }

    fn read(root: &mut Table<'_>) -> Option<Self> {
        let (site, seed) = root.section("site", "The site.", site::read);
        let record = root.section(
            "record",
            "How samples are cut into records, and when one is refused.",
            record::read,
        );
        let (welch, peaks) = root.section(
            "spectrum",
            "Power spectral density and its peaks.",
            spectrum::read,
        );
        let modes = root.section("modes", "Which natural frequencies are looked for.", modes::read);
        let abc = root.section(
            "abc",
            "Approximate Bayesian computation of the axial force.",
            abc::read,
        );
        let model = root.section(
            "emulator",
            "The forward model that answers for the frequencies.",
            emulator::read,
        );
        let track = root.section("track", "How the relative force is followed.", track::read);
        let alarm = root.section("alarm", "When somebody is told.", alarm::read);
        let store = root.section("store", "Where results are kept.", store::read);
        let ingest = IngestSettings {
            readings_s: track.reorder_window_s.min(alarm.silence_s / 2.0),
            ..root.section("ingest", "Where live data comes from (`run`).", ingest::read)
        };
        let journal = root.section("journal", "Live data on disk (`run`).", journal::read);
        let http = root.section("http", "The daemon's HTTP server (`run`).", http::read);
        let shared = rod::Shared {
            welch,
            peaks,
            modes,
            abc,
            model,
            seed,
            wait_s: track.reorder_window_s,
        };
        let rods = rod::read_all(root, &shared);
        emulator::check_chaos(root, model, &rods);
        sensor::check_patience(root, alarm.silence_s, &rods);
        #[cfg(feature = "daemon")]
        let sinks = sink::read_all(root, sink::Whose::Site(&rods));
        #[cfg(feature = "daemon")]
        let alert = root.section(
            "alert",
            "How the sinks are told of the daemon itself (`run`).",
            |table| sink::heartbeat::read(table, sinks.as_deref()),
        );
        #[cfg(feature = "daemon")]
        let forward = root.optional_section(
            "forward",
            "Copy of the results to a centre of many sites (`run`).",
            |table| forward::read(table, &store),
        );
        #[cfg(feature = "daemon")]
        let forward = match forward {
            Some(forward) => Some(forward?),
            None => None,
        };
        #[cfg(feature = "daemon")]
        let bucket = root.optional_section(
            "bucket",
            "Copy of the journal's parts to object storage (`run`).",
            bucket::read,
        );
        #[cfg(feature = "daemon")]
        let bucket = match bucket {
            Some(bucket) => Some(bucket?),
            None => None,
        };
        // Addresses and mailboxes are checked by the crates that use them.
        #[cfg(not(feature = "daemon"))]
        root.ignore(&["sink", "alert", "forward", "bucket"]);
        let simulation = root.optional_section("simulation", "What `tirante simulate` writes.", |table| {
            simulation::read(table, &rods)
        });
        let simulation = match simulation {
            Some(simulation) => Some(simulation?),
            None => None,
        };
        Some(Self {
            site,
            seed,
            rods: rods.into_iter().collect::<Option<Vec<_>>>()?,
            record,
            track,
            alarm,
            store,
            ingest,
            journal,
            http,
            #[cfg(feature = "daemon")]
            sinks: sinks?,
            #[cfg(feature = "daemon")]
            alert,
            #[cfg(feature = "daemon")]
            forward,
            #[cfg(feature = "daemon")]
            bucket,
            simulation,
            effective: effective::Node::root(),
        })
    }

    /// The rod called `id`.
    pub fn rod(&self, id: &str) -> Option<&RodConfig> {
        self.rods.iter().find(|rod| rod.analysis.rod.0 == id)
    }

    /// True if a rod reads this topic.
    pub fn reads(&self, topic: &str) -> bool {
        let mut channels = self.rods.iter().flat_map(|rod| rod.channels.all());
        channels.any(|channel| channel.topic == topic)
    }

    /// The configuration with every default filled in, as commented TOML that reads back equal.
    pub fn effective(&self) -> String {
        let mut text = String::new();
        self.effective.print(true, &mut text);
        text
    }

    /// SHA-256 of the effective configuration without comments and without the sections that affect no result
    /// (`[simulation]`, `[ingest]`, `[journal]`, `[http]`, `[[sink]]`, `[alert]`, `[forward]`, `[bucket]`): equal for texts that mean
    /// the same for measured data.
    pub fn hash(&self) -> [u8; 32] {
        let mut text = String::new();
        let mut effective = self.effective.clone();
        effective
            .children
            .retain(|section| !OPERATION.contains(&section.name()));
        effective.print(false, &mut text);
        Sha256::digest(text.as_bytes()).into()
    }

    /// Hash of everything that determines the meaning of one rod's numbers: the sections its analysis and
    /// tracking read, and the rod itself with its declared sample rate and clock. Names, alarms, other rods, and the place of its
    /// samples in recordings do not change it.
    pub fn meaning_of(&self, rod: &RodId) -> [u8; 32] {
        let mut text = format!("seed = {}\n", self.seed);
        for section in self.sections_of(rod) {
            section.print(false, &mut text);
        }
        Sha256::digest(text.as_bytes()).into()
    }

    /// Settings that change the meaning of a rod's numbers from that in `before`, each as `key: old -> new`.
    pub fn changes_of(&self, before: &Self, rod: &RodId) -> Vec<String> {
        let settings = |config: &Self| {
            let mut settings = BTreeMap::from([("site.seed".to_owned(), config.seed.to_string())]);
            for section in config.sections_of(rod) {
                section.collect(&mut settings);
            }
            settings
        };
        let (old, new) = (settings(before), settings(self));
        let keys: BTreeSet<&String> = old.keys().chain(new.keys()).collect();
        let shown = |value: Option<&String>| value.map_or("nothing", String::as_str).to_owned();
        keys.into_iter()
            .filter(|key| old.get(*key) != new.get(*key))
            .map(|key| format!("{key}: {} -> {}", shown(old.get(key)), shown(new.get(key))))
            .collect()
    }

    /// Sections that determine the meaning of a rod's numbers.
    fn sections_of(&self, rod: &RodId) -> Vec<effective::Node> {
        let mut sections = self.effective.children.clone();
        sections.retain(|section| match section.name() {
            "record" | "spectrum" | "modes" | "abc" | "emulator" | "track" => true,
            "rod" => section.value_of("id") == Some(&range::toml_string(&rod.0)),
            _ => false,
        });
        for section in &mut sections {
            // Tracking follows frequencies, and those of one mode are the same at every place of the rod: a sensor that is added, lost
            // or moved changes their errors, which every record tells, and the amplitude ratios, which move the absolute posterior
            // alone. The baseline stays; each row names its sensors.
            section.children.retain(|child| child.name() != "rod.sensor");
            // The topic and the path to the values change no number. All frequencies follow the rate, and so the clock that it is
            // counted by; of a thermometer these say no more than which readings are near a record.
            for channel in &mut section.children {
                let is_rate = |line: &effective::Line| match line.key {
                    "fs_hz" => true,
                    "time" => line.value.as_ref() != Some(&line.default),
                    _ => false,
                };
                match channel.name() {
                    "rod.channel" => channel.lines.retain(|line| line.key == "unit" || is_rate(line)),
                    "rod.temperature" => channel.lines.retain(|line| line.key == "unit"),
                    _ => {}
                }
            }
        }
        sections
    }

    /// All keys of the sections that this configuration has, for the documentation.
    pub fn reference(&self) -> Vec<KeyReference> {
        let mut keys = Vec::new();
        self.effective.reference(&mut keys);
        keys
    }
}

/// Reads a text called `origin` in messages, overridden by `settings`, as `read` takes it; `least` names an example for an
/// empty one. Returns the values in effect, too.
fn parse_tables<T>(
    text: &str,
    origin: &str,
    settings: &[Setting],
    least: &str,
    read: impl FnOnce(&mut Table<'_>) -> Option<T>,
) -> Result<(T, effective::Node), ConfigError> {
    let refused = |faults: Faults| ConfigError::Faults {
        origin: origin.to_owned(),
        faults: faults.into_sorted(),
    };
    // Settings are appended to the text; blanks before each give its values their positions there.
    let mut whole = text.to_owned();
    let mut padded = Vec::new();
    for setting in settings {
        whole.push('\n');
        // A width in a format would end at 65 535.
        padded.push(format!("{}{setting}", " ".repeat(whole.len())));
        whole += &setting.to_string();
    }
    let faults = Faults::new(&whole, text.len());
    let (mut entries, mut errors) = DeTable::parse_recoverable(text);
    for (line, setting) in padded.iter().zip(settings) {
        let (over, more) = DeTable::parse_recoverable(line);
        setting::merge(entries.get_mut(), over.into_inner(), setting.levels());
        errors.extend(more);
    }
    for error in &errors {
        let at = error.span().map_or(text.len(), |span| span.start);
        faults.add("", at, format!("no TOML: {}", error.message()));
    }
    if entries.get_ref().is_empty() && errors.is_empty() {
        faults.add(
            "",
            0,
            format!("the configuration is empty; {least} shows the least it needs"),
        );
        return Err(refused(faults));
    }
    let mut root = Table::root(&faults, entries.get_ref());
    let config = read(&mut root);
    let effective = root.finish();
    if !errors.is_empty() {
        faults.distrust_after_broken_text();
    }
    match config {
        Some(config) if faults.count() == 0 => Ok((config, effective)),
        _ => Err(refused(faults)),
    }
}

/// Reads the text of a configuration file of at most [`LONGEST`] bytes.
///
/// # Errors
/// It is no regular file, too long, not UTF-8, or cannot be read.
pub fn read_text(path: &Path) -> Result<String, ConfigError> {
    let unreadable = |reason: String| ConfigError::Unreadable {
        path: path.to_owned(),
        reason,
    };
    let system = |error: std::io::Error| unreadable(error.to_string());
    let kind = std::fs::metadata(path).map_err(system)?;
    if !kind.is_file() {
        return Err(unreadable("is no regular file".to_owned()));
    }
    let mut bytes = Vec::new();
    File::open(path)
        .map_err(system)?
        .take(LONGEST as u64 + 1)
        .read_to_end(&mut bytes)
        .map_err(system)?;
    if bytes.len() > LONGEST {
        return Err(unreadable(format!(
            "is longer than {LONGEST} bytes, no configuration is"
        )));
    }
    String::from_utf8(bytes).map_err(|error| {
        let good = error.utf8_error().valid_up_to();
        let line = error.as_bytes()[..good]
            .iter()
            .filter(|byte| **byte == b'\n')
            .count()
            + 1;
        unreadable(format!("is not UTF-8 text, first bad byte in line {line}"))
    })
}
