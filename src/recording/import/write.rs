//! Writes a plan to MCAP.

use super::order::Order;
use super::plan::Plan;
use crate::write::{ChannelSpec, Precision, RecordingWriter, SinkError};
use std::io::{Seek, Write};

/// Writes every sample of the plan, bit for bit; returns the number of messages.
///
/// # Errors
/// As of the writer; a time before 1970.
pub fn write<W: Write + Seek>(writer: &mut RecordingWriter<W>, plan: &Plan) -> Result<u64, SinkError> {
    let mut ids = Vec::with_capacity(plan.channels.len());
    for channel in &plan.channels {
        ids.push(writer.add_channel(ChannelSpec {
            topic: channel.topic.clone(),
            encoding: plan.encoding,
            layout: channel.layout,
            precision: Precision::Double,
            unit: channel.unit,
        })?);
    }
    let mut count = 0;
    let mut order = Order::new(plan);
    while let Some((index, time, samples)) = order.next(plan) {
        if let (Some(channel), Some(id)) = (plan.channels.get(index), ids.get(index)) {
            let values = channel.values.get(samples).unwrap_or_default();
            writer.write_message(*id, time, channel.fs_hz, values)?;
            count += 1;
        }
    }
    Ok(count)
}
