//! Resumes a journal from its last part.

use crate::recording::note::{Note, Standing, State, TOPIC};
use crate::recording::part;
use crate::recording::read::Trust;
use crate::recording::read::mcap::{Item, Progress, Reader};
use crate::recording::read::series::is_blank;
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::Path;

/// State of a journal.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Standings {
    /// Name of the journal; `None` if there is none yet.
    pub journal: Option<String>,
    /// Number of the next part.
    pub next: u32,
    /// Streams of the journal.
    pub streams: BTreeMap<String, Standing>,
    /// Damage of the last part, if any.
    pub damage: Option<String>,
}

/// Reads the last part with a note. Its content is made durable first: a crash may have left it in memory.
pub(super) fn look(folder: &Path) -> io::Result<Standings> {
    let parts = part::list(folder)?;
    let mut found = Standings {
        next: parts.last().map_or(1, |last| last.saturating_add(1)),
        ..Standings::default()
    };
    for number in parts.into_iter().rev() {
        let path = part::path(folder, number);
        let file = File::open(&path)?;
        file.sync_all()?;
        read(&file, &mut found).unwrap_or_else(|damage| {
            found.damage = Some(format!("{}: {damage}", path.display()));
        });
        // A part without a single whole chunk gives no information, and nothing in it was acknowledged.
        if found.journal.is_some() {
            break;
        }
    }
    Ok(found)
}

fn read(file: &File, found: &mut Standings) -> Result<(), String> {
    let mut reader = Reader::new(file, Trust::Unverified, false);
    let mut notes = None;
    loop {
        let progress = reader.step(&mut |item| match item {
            Item::Channel(id, channel, _) if channel.topic == TOPIC => notes = Some(id),
            Item::Message(message) if Some(message.channel) == notes => {
                if let Ok(note) = serde_json::from_slice::<Note>(message.data) {
                    take(note, found);
                }
            }
            _ => {}
        });
        match progress {
            Ok(Progress::More) => {}
            Ok(_) => return Ok(()),
            // After a power cut the end of a torn part may be blank.
            Err(_) if is_blank(file, reader.offset()) => return Ok(()),
            Err(damage) => return Err(format!("at byte {}: {}", damage.offset, damage.what)),
        }
    }
}

fn take(note: Note, found: &mut Standings) {
    if let Some(begins) = note.begins {
        found.journal = Some(begins.journal);
        found.streams.clear();
    }
    for (name, standing) in note.streams {
        if standing.state == State::Complete {
            found.streams.remove(&name);
        } else {
            found.streams.insert(name, standing);
        }
    }
}
