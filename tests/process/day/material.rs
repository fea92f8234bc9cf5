//! Hours of four rods with faults of their own, packed by the way each comes, and what an undisturbed replay makes of them.

use crate::site::rods::{RESTRAINED, rod_with_air, simulated_rod};
use crate::survival::campaign::{Data, RODS, lines_of, results, simulate, tirante};
use mcap::Message;
use rand::{Rng, RngExt};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::io::Cursor;
use std::path::PathBuf;
use std::sync::Arc;
use tempfile::TempDir;
use tirante::analysis::numerics::random;

/// Begin of the first record \[s since 1970\]: 2024-03-01, too long ago for a start to take it for silence.
const START_S: u64 = 1_709_251_200;
/// Records come in stretches with a gap behind each.
const STRETCH_S: u64 = 300;
const WINDOW_S: u64 = 59;
const WINDOWS: u64 = 5;
/// Stretches of one file of the rod `north`.
const OF_FILE: usize = 6;

/// A time in which a rod's samples are worth nothing.
pub struct Spoiled {
    pub rod: &'static str,
    pub from_ns: i64,
    pub to_ns: i64,
    what: String,
}

/// What is fed, and what comes of it.
pub struct Material {
    folder: TempDir,
    pub data: Arc<Data>,
    /// Hours of event time.
    pub hours: usize,
    pub spoiled: Vec<Spoiled>,
    /// Files that are damaged or cut short.
    pub broken: Vec<String>,
    /// Results of an undisturbed replay.
    pub replayed: BTreeMap<String, String>,
    /// Records among them.
    pub records: usize,
}

pub fn site(rods: &[&str]) -> String {
    let mut text = format!(
        "[site]\nname = \"A day\"\nseed = 11\n[abc]\ndraws = 1000\naccept = {{ quantile = 0.1 }}\n\
         [record]\ncut = \"window\"\nwindow_s = {WINDOW_S}\nmin_duration_s = 20\n\
         [track]\nbaseline_records = 30\nlearning_periods = 10\nparticles = 256\nperiod_h = 1\n\
         [alarm]\ncompare_rods = false\n"
    );
    for (number, id) in rods.iter().enumerate() {
        text += &rod_with_air(id, 6.5 + 1.5 * number as f64, &format!("/air/{id}"));
    }
    text
}

/// One fault of a stretch, from a seed: its keys, and the seconds of the stretch that are worthless.
fn fault(rng: &mut impl Rng) -> (String, Option<(u64, u64)>) {
    let begin = WINDOW_S * rng.random_range(0..WINDOWS);
    let part = |kind: &str, at: u64, length: u64| {
        let keys = format!("kind = \"{kind}\"\nat_s = {at}.0\nlength_s = {length}.0\n");
        (keys, Some((at, at + length)))
    };
    let all = Some((1, STRETCH_S - 6));
    let harmless = |keys: String| (keys, None);
    match rng.random_range(0..16u8) {
        0 => part("nan", begin + 5, 45),
        1 => part("held", begin + 5, 45),
        // Five useless records in a row are an alarm. To the last sample, not into the gap behind: with a clock that jitters the next record may
        // begin a moment before its stretch.
        2 | 3 => part("held", 0, WINDOW_S * WINDOWS),
        4 => ("kind = \"clipped\"\nlevel_m = 8e-6\n".to_owned(), all),
        5 => {
            let at = begin + 30;
            let keys = format!("kind = \"step\"\nat_s = {at}.0\nheight_m = 2e-3\n");
            (keys, Some((at - 1, at + 1)))
        }
        6 => harmless("kind = \"spikes\"\nper_hour = 200.0\nheight_m = 1e-3\n".to_owned()),
        7 => harmless("kind = \"scaled\"\nfactor = 1000.0\n".to_owned()),
        8 => harmless(format!("kind = \"nan\"\nat_s = {begin}.0\nlength_s = 0.4\n")),
        9 => harmless(format!(
            "kind = \"dropout\"\nat_s = {}.0\nlength_s = 20.0\n",
            begin + 20
        )),
        10 => harmless("kind = \"lost\"\nshare = 0.02\n".to_owned()),
        11 => harmless("kind = \"duplicates\"\nshare = 0.3\n".to_owned()),
        12 => harmless("kind = \"out-of-order\"\nshare = 0.1\n".to_owned()),
        13 => harmless(format!(
            "kind = \"clock-step\"\nat_s = {}.0\nstep_s = 3.0\n",
            begin + 20
        )),
        14 => harmless(format!(
            "kind = \"late\"\nat_s = {}.0\nlate_s = 0.4\n",
            begin + 20
        )),
        _ => harmless("kind = \"jitter\"\nsd_s = 0.002\n".to_owned()),
    }
}

/// Recordings of all rods, their faults drawn from `rng`.
struct Simulation {
    stretches: usize,
    spoiled: Vec<Spoiled>,
}

impl Simulation {
    /// Recording of a rod.
    fn recording(&mut self, folder: &TempDir, rod: &'static str, seed: u64, encoding: &str) -> Vec<u8> {
        let mut rng = random::stream(seed, u64::from(rod.as_bytes()[0]));
        let mut special = RESTRAINED.to_owned();
        let loss_d = 0.75 * self.stretches as f64 * STRETCH_S as f64 / 86_400.0;
        if rod == "south" {
            write!(
                special,
                "[[simulation.rod.change]]\nstart_d = {loss_d:?}\nrelative = -0.10\n"
            )
            .unwrap();
        }
        for stretch in 0..self.stretches {
            if !rng.random_bool(0.15) {
                continue;
            }
            let (keys, worthless) = fault(&mut rng);
            let number = stretch + 1;
            write!(
                special,
                "[[simulation.rod.fault]]\n{keys}first_record = {number}\nlast_record = {number}\n"
            )
            .unwrap();
            if let Some((from, to)) = worthless {
                let ns = |second: u64| (START_S + STRETCH_S * stretch as u64 + second) as i64 * 1_000_000_000;
                self.spoiled.push(Spoiled {
                    rod,
                    from_ns: ns(from),
                    to_ns: ns(to),
                    what: keys,
                });
            }
        }
        let config = site(&RODS)
            + &format!(
                "[simulation]\nstart = 2024-03-01T00:00:00Z\nrecords = {}\ninterval_s = {STRETCH_S}.0\nrecord_s = {}.0\n\
                 fs_hz = 100.0\nsamples_per_message = 100\nencoding = \"{encoding}\"\n\
                 [simulation.climate]\nmean_c = 12.0\nday_k = 4.0\nweather_k = 1.0\nevery_s = 60\n",
                self.stretches,
                WINDOW_S * WINDOWS
            )
            + &simulated_rod(rod, 142e3, 3, &special);
        let path = simulate(folder.path(), &format!("{rod}.mcap"), &config, seed as usize);
        fs::read(path).unwrap()
    }

    /// Messages of a recording in its order; the thermometer shows one value for a sixth of the time.
    fn messages<'a>(&self, recording: &'a [u8], rng: &mut impl Rng) -> Vec<Message<'a>> {
        let stream = mcap::MessageStream::new(recording).unwrap();
        let mut messages: Vec<Message> = stream.map(Result::unwrap).collect();
        let length_s = self.stretches as u64 * STRETCH_S;
        let from_s = START_S + rng.random_range(0..length_s);
        let is_stuck = |message: &Message| {
            message.channel.topic.starts_with("/air")
                && (from_s..from_s + length_s / 6).contains(&(message.log_time / 1_000_000_000))
        };
        let mut shown = None;
        for message in messages.iter_mut().filter(|message| is_stuck(message)) {
            let shown = shown.get_or_insert_with(|| message.data.clone());
            message.data.clone_from(shown);
        }
        messages
    }
}

/// Stretch of a message. A clock that jitters may place its first message just before it: behind each stretch is a gap of more than a second.
fn stretch_of(message: &Message) -> usize {
    ((message.log_time / 1_000_000_000 + 1 - START_S) / STRETCH_S) as usize
}

/// A file with a chunk a stretch. Without a summary its messages are read in its own order, as those of a stream are.
fn packed(stretches: &[&[Message]], has_summary: bool) -> Vec<u8> {
    let options = mcap::WriteOptions::new()
        .chunk_size(Some(64 << 20))
        .emit_message_indexes(has_summary)
        .emit_summary_records(has_summary)
        .emit_summary_offsets(has_summary)
        .disable_seeking(true);
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    for stretch in stretches {
        for message in *stretch {
            writer.write(message).unwrap();
        }
        writer.flush().unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// The messages by stretch.
fn stretches<'a, 'b>(messages: &'a [Message<'b>]) -> Vec<&'a [Message<'b>]> {
    messages
        .chunk_by(|one, next| stretch_of(one) == stretch_of(next))
        .collect()
}

impl Material {
    pub fn new(seed: u64, hours: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut rng = random::stream(seed, 1);
        let mut simulation = Simulation {
            stretches: hours * (3600 / STRETCH_S) as usize,
            spoiled: Vec::new(),
        };
        let encodings = ["protobuf", "protobuf", "protobuf", "json"];
        let recordings =
            [0, 1, 2, 3].map(|rod| simulation.recording(&folder, RODS[rod], seed, encodings[rod]));
        let [north, west, south, east] =
            [0, 1, 2, 3].map(|rod: usize| simulation.messages(&recordings[rod], &mut rng));
        let archive = folder.path().join("archive");
        fs::create_dir(&archive).unwrap();

        let (mut broken, mut files) = (Vec::new(), Vec::new());
        let groups = stretches(&north);
        let last = groups.len().div_ceil(OF_FILE) - 1;
        for (number, group) in groups.chunks(OF_FILE).enumerate() {
            let mut group = group.to_vec();
            let place = rng.random_range(0..group.len() - 1);
            if rng.random_bool(0.2) {
                // Blocks that were written late.
                group.swap(place, place + 1);
            }
            let mut bytes = packed(&group, true);
            let at = rng.random_range(bytes.len() / 4..bytes.len() * 3 / 4);
            let is_damaged = rng.random_bool(0.15);
            // A file without an end is waited for, and its last record comes late: behind it there is no other.
            if number == last {
                bytes.truncate(at);
            } else if is_damaged {
                bytes[at..at + 64].iter_mut().for_each(|byte| *byte ^= 0x55);
            }
            let name = format!("north-{number:03}.mcap");
            fs::write(archive.join(&name), &bytes).unwrap();
            if number == last || is_damaged {
                broken.push(name);
            }
            files.push(bytes);
        }
        let growing = packed(&stretches(&west), false);
        fs::write(archive.join("west.mcap"), &growing).unwrap();
        let sent: Vec<_> = stretches(&south)
            .chunks(3)
            .enumerate()
            .map(|(number, group)| {
                let path = folder.path().join(format!("south-{number:03}.mcap"));
                fs::write(&path, packed(group, false)).unwrap();
                path
            })
            .collect();
        let east_file = packed(&stretches(&east), false);
        fs::write(folder.path().join("east.mcap"), &east_file).unwrap();
        let data = Data {
            files,
            growing,
            sent,
            lines: lines_of(&east_file),
        };
        let mut material = Self {
            folder,
            data: Arc::new(data),
            hours,
            spoiled: simulation.spoiled,
            broken,
            replayed: BTreeMap::new(),
            records: 0,
        };
        material.replay();
        material
    }

    /// The undisturbed answer. Rod by rod: the files of others have no place in it. Each file that is sent is a stream of its own, and records
    /// end with it.
    fn replay(&mut self) {
        fs::write(self.path("replayed.toml"), site(&RODS)).unwrap();
        let sent = self.data.sent.iter().map(|path| vec![path.to_str().unwrap()]);
        let north: Vec<_> = (0..self.data.files.len())
            .map(|number| format!("archive/north-{number:03}.mcap"))
            .collect();
        let north: Vec<_> = north.iter().map(String::as_str).collect();
        let whole = [north, vec!["archive/west.mcap"], vec!["east.mcap"]];
        for paths in whole.into_iter().chain(sent) {
            let words = ["replay", "--config", "replayed.toml", "--store", "replayed.db"];
            let output = tirante(self.folder.path(), &[&words[..], &paths].concat());
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(matches!(output.status.code(), Some(0 | 3)), "{said}");
        }
        self.replayed = results(&self.path("replayed.db"));
        let records = |text: &String| text.lines().filter(|line| line.starts_with("record\t")).count();
        self.records = self.replayed.values().map(records).sum();
        // Five windows of each stretch, less what was damaged, and more where a fault parts a window.
        let whole = RODS.len() * self.hours * 60;
        assert!(
            self.records * 10 > whole * 9 && self.records * 10 < whole * 11,
            "{} records of {whole}",
            self.records
        );
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}

impl std::fmt::Display for Spoiled {
    fn fmt(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            to,
            "{} from {} to {}: {}",
            self.rod, self.from_ns, self.to_ns, self.what
        )
    }
}
