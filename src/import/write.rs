//! A plan to MCAP: the messages of all channels side by side in time, as a recorder would write them.

use super::plan::{Plan, Planned};
use crate::record::Timestamp;
use crate::sink::{ChannelSpec, Layout, Precision, RecordingWriter, SinkError};
use std::io::{Seek, Write};
use std::ops::Range;

/// Writes every sample as the plan has it, bit for bit; the number of messages.
///
/// # Errors
/// As of the writer; a time before 1970.
pub fn write<W: Write + Seek>(writer: &mut RecordingWriter<W>, plan: &Plan) -> Result<u64, SinkError> {
    let mut cursors = Vec::with_capacity(plan.channels.len());
    for channel in &plan.channels {
        let id = writer.add_channel(ChannelSpec {
            topic: channel.topic.clone(),
            encoding: plan.encoding,
            layout: channel.layout,
            precision: Precision::Double,
            unit: channel.unit,
        })?;
        let mut messages = messages(channel);
        cursors.push((messages.next(), messages, id, channel));
    }
    let mut count = 0;
    loop {
        let next = cursors.iter_mut().filter(|(next, ..)| next.is_some());
        let Some((next, messages, id, channel)) =
            next.min_by_key(|(next, ..)| next.as_ref().map(|(time, _)| *time))
        else {
            return Ok(count);
        };
        if let Some((time, samples)) = next.take() {
            let values = channel.values.get(samples).unwrap_or_default();
            writer.write_message(*id, time, channel.fs_hz, values)?;
            count += 1;
        }
        *next = messages.next();
    }
}

/// The messages of a channel: the time of the first sample of each, and its samples.
fn messages(channel: &Planned) -> impl Iterator<Item = (Timestamp, Range<usize>)> + use<'_> {
    let length = match channel.layout {
        Layout::Sample => 1,
        Layout::Batch(length) => length.max(1),
    };
    channel.stretches.iter().flat_map(move |(start, samples)| {
        samples.clone().step_by(length).map(move |begin| {
            let time = start.plus_seconds((begin - samples.start) as f64 / channel.fs_hz);
            (time, begin..samples.end.min(begin + length))
        })
    })
}
