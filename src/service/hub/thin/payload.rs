//! Messages of a site without a computer as recordings: each MCAP file as it is, JSON lines together.

use crate::recording::atomic::AtomicFile;
use crate::service::hub::incoming::Incoming;
use crate::service::ingest::line::{self, Line};
use mcap::MAGIC;
use mcap::records::MessageHeader;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

/// True for a message that is an MCAP file.
pub fn is_recording(message: &Incoming) -> bool {
    message.payload.starts_with(MAGIC)
}

/// Recordings of some messages.
#[derive(Debug, Default)]
pub struct Written {
    /// Files by name, each with the message that it is; `None` where it has the lines of several.
    pub files: BTreeMap<String, Option<Incoming>>,
    /// Messages that are not read, or not all of it, with the reason.
    pub unread: Vec<(Incoming, String)>,
}

/// Writes messages, in their order, as files of a folder.
///
/// # Errors
/// The folder cannot be written.
pub fn write(folder: &Path, messages: Vec<Incoming>) -> io::Result<Written> {
    let mut written = Written::default();
    let mut lines = Lines::default();
    for message in messages {
        // The number alone may come again, of a stream that was made anew.
        let name = format!("{:020}-{}.mcap", message.sequence, message.time_ns);
        if is_recording(&message) {
            lines.write(folder, &mut written)?;
            let mut file = AtomicFile::create(&folder.join(&name))?;
            file.write_all(&message.payload)?;
            file.commit()?;
            written.files.insert(name, Some(message));
            continue;
        }
        lines.name.get_or_insert(name);
        if let Err(reason) = lines.take(&message) {
            written.unread.push((message, reason));
        }
    }
    lines.write(folder, &mut written)?;
    Ok(written)
}

/// JSON lines that make a file together.
#[derive(Default)]
struct Lines {
    /// Name of the file, once there is a message for it.
    name: Option<String>,
    /// Topic, time and text of each.
    samples: Vec<(String, u64, Vec<u8>)>,
}

impl Lines {
    /// Takes the lines of a message; a sample without a time was measured when the server took the message.
    ///
    /// # Errors
    /// The first line that is no sample; the others are taken.
    fn take(&mut self, message: &Incoming) -> Result<(), String> {
        let arrived = u64::try_from(message.time_ns).unwrap_or(0);
        let mut fault = None;
        for (number, text) in (1..).zip(message.payload.split(|byte| *byte == b'\n')) {
            let text = text.trim_ascii();
            if text.is_empty() {
                continue;
            }
            match line::parse(text) {
                Ok(Line::Data { topic, time }) => {
                    self.samples.push((topic, time.unwrap_or(arrived), text.to_vec()));
                }
                Ok(Line::End | Line::Hello(_)) => {}
                Err(what) => fault = fault.or(Some(format!("line {number} {what}"))),
            }
        }
        fault.map_or(Ok(()), Err)
    }

    /// Writes them as a recording, if there are any, and begins anew.
    fn write(&mut self, folder: &Path, written: &mut Written) -> io::Result<()> {
        let Self { name, samples } = std::mem::take(self);
        let Some(name) = name.filter(|_| !samples.is_empty()) else {
            return Ok(());
        };
        let broken = |error: mcap::McapError| io::Error::other(error.to_string());
        let mut writer = mcap::WriteOptions::new()
            .compression(None)
            .create(AtomicFile::create(&folder.join(&name))?)
            .map_err(broken)?;
        let mut channels = BTreeMap::new();
        for (sequence, (topic, time, text)) in (0..).zip(samples) {
            let channel_id = match channels.get(&topic) {
                Some(known) => *known,
                None => {
                    let made = writer.add_channel(0, &topic, "json", &BTreeMap::new());
                    let made = made.map_err(broken)?;
                    channels.insert(topic, made);
                    made
                }
            };
            let header = MessageHeader {
                channel_id,
                sequence,
                log_time: time,
                publish_time: time,
            };
            writer.write_to_known_channel(&header, &text).map_err(broken)?;
        }
        writer.finish().map_err(broken)?;
        writer.into_inner().commit()?;
        written.files.insert(name, None);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn message(sequence: i64, payload: &[u8]) -> Incoming {
        Incoming {
            sequence,
            subject: "tirante.v1.raw.todi".to_owned(),
            headers: String::new(),
            payload: payload.to_vec(),
            time_ns: 5,
        }
    }

    #[test]
    fn recordings_stay_as_they_are_and_lines_come_together() {
        let folder = tempfile::tempdir().unwrap();
        let recording = [MAGIC, b"whatever"].concat();
        let written = write(
            folder.path(),
            vec![
                message(
                    7,
                    b"{\"topic\":\"/a\",\"time\":3,\"value\":1}\n\n{\"topic\":\"/b\",\"value\":2}",
                ),
                message(
                    8,
                    b"{\"topic\":\"/a\",\"time\":4,\"value\":1}\nnothing\n{\"topic\":\"/a\",\"time\":9}\n",
                ),
                message(9, &recording),
                message(12, b"nothing at all"),
            ],
        )
        .unwrap();
        let names: Vec<&String> = written.files.keys().collect();
        assert_eq!(
            names,
            ["00000000000000000007-5.mcap", "00000000000000000009-5.mcap"]
        );
        let unread: Vec<i64> = written
            .unread
            .iter()
            .map(|(message, _)| message.sequence)
            .collect();
        assert_eq!(unread, [8, 12]);
        assert!(
            written.unread[0].1.starts_with("line 2 cannot be read"),
            "{}",
            written.unread[0].1
        );
        assert_eq!(fs::read(folder.path().join(names[1])).unwrap(), recording);
        let lines = fs::read(folder.path().join(names[0])).unwrap();
        let read: Vec<(String, u64)> = mcap::MessageStream::new(&lines)
            .unwrap()
            .map(|message| {
                let message = message.unwrap();
                (message.channel.topic.clone(), message.log_time)
            })
            .collect();
        let of = |topic: &str, time| (topic.to_owned(), time);
        assert_eq!(read, [of("/a", 3), of("/b", 5), of("/a", 4), of("/a", 9)]);
    }
}
