//! Recordings as one series of channels and messages, in the order of their data: each in that of its log times, as `replay` reads it.

use crate::recording::read::Finished;
use crate::recording::read::mcap::{Item, Progress};
use crate::service::journal::Definition;
use std::collections::{HashMap, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;

/// A channel as its recording declares it.
#[derive(Debug, Clone)]
pub(super) struct Channel {
    /// Id in the recording.
    pub id: u16,
    pub topic: String,
    pub encoding: String,
    pub schema: Option<Definition>,
}

/// A message of its recording.
#[derive(Debug, Clone)]
pub(super) struct Message {
    pub channel: u16,
    /// Time of recording \[ns since 1970\].
    pub log_time: u64,
    /// Time of sending \[ns since 1970\].
    pub publish_time: u64,
    pub data: Vec<u8>,
}

/// Next item of a recording.
pub(super) enum Piece {
    /// Another recording begins: channels have new ids.
    File,
    Channel(Channel),
    Message(Message),
    /// A fact that is no loss.
    Note(String),
    /// A recording is damaged or cannot be read, with the reason: the items before are good.
    Loss(String),
}

/// Reads recordings one after another; holds one chunk, or those that are put in order. The same recordings give the same messages in the
/// same order: a stream that was cut goes on by their number.
pub(super) struct Playback {
    files: std::vec::IntoIter<PathBuf>,
    open: Option<(PathBuf, Finished)>,
    pieces: VecDeque<Piece>,
    /// Schemas of the open recording, by id.
    definitions: HashMap<u16, Definition>,
    bytes_of_closed: u64,
}

impl Playback {
    pub fn new(files: Vec<PathBuf>) -> Self {
        Self {
            files: files.into_iter(),
            open: None,
            pieces: VecDeque::new(),
            definitions: HashMap::new(),
            bytes_of_closed: 0,
        }
    }

    /// Number of bytes read.
    pub fn bytes(&self) -> u64 {
        self.bytes_of_closed + self.open.as_ref().map_or(0, |(_, reader)| reader.bytes_read())
    }
}

impl Iterator for Playback {
    type Item = Piece;

    fn next(&mut self) -> Option<Piece> {
        loop {
            if let Some(piece) = self.pieces.pop_front() {
                return Some(piece);
            }
            let Some((path, reader)) = &mut self.open else {
                let path = self.files.next()?;
                match Finished::open(&path) {
                    Ok(mut file) => {
                        let beyond = file.take_beyond();
                        let note = beyond.map(|what| Piece::Note(format!("{}: {what}", path.display())));
                        self.pieces.extend(note);
                        self.open = Some((path, file));
                        self.definitions.clear();
                        return Some(Piece::File);
                    }
                    Err(fault) => {
                        return Some(Piece::Loss(format!(
                            "{}: cannot be read: {fault}",
                            path.display()
                        )));
                    }
                }
            };
            let (pieces, definitions) = (&mut self.pieces, &mut self.definitions);
            let outcome = reader.step(&mut |item| match item {
                Item::Channel(id, channel, schema) => pieces.push_back(Piece::Channel(Channel {
                    id,
                    topic: channel.topic.clone(),
                    encoding: channel.encoding.clone(),
                    schema: schema.map(|schema| {
                        let known = definitions.entry(channel.schema);
                        Arc::clone(known.or_insert_with(|| Arc::new(schema.owned())))
                    }),
                })),
                Item::Message(message) => pieces.push_back(Piece::Message(Message {
                    channel: message.channel,
                    log_time: message.log_time,
                    publish_time: message.publish_time,
                    data: message.data.to_vec(),
                })),
                Item::Unverified => {}
                Item::Hole(hole) => pieces.push_back(Piece::Loss(format!(
                    "{}: {}; what follows is sent",
                    path.display(),
                    hole.sentence(std::iter::empty())
                ))),
            });
            let loss = match outcome {
                Ok(Progress::More) => continue,
                Ok(Progress::Complete) => None,
                Ok(Progress::Wait | Progress::Truncated) => Some("is cut short".to_owned()),
                Err(damage) => Some(format!("at byte {}: {}", damage.offset, damage.what)),
            };
            if let Some(what) = loss {
                pieces.push_back(Piece::Loss(format!(
                    "{}: {what}; what came before is sent",
                    path.display()
                )));
            }
            self.bytes_of_closed += reader.bytes_read();
            self.open = None;
        }
    }
}
