//! A message into the samples of a rod.

use super::rod::{Count, Rod};
use crate::read::decode::{DecodeError, Decoded, PIECE, Time};
use crate::read::mcap::Message;
use crate::read::plans::Route;
use std::sync::Arc;
use tirante_analysis::signal::record::{TimeSource, Timestamp};

/// Nanoseconds of a time that counts whole seconds, milliseconds or microseconds: programs write 1772344800.0 as 1772344800. Nanoseconds
/// since 1970 it cannot be if in such a unit it lies within a day of the time at which it was logged.
#[inline]
fn of_coarser_unit(time: i64, log_time: u64) -> Option<i64> {
    const DAY_NS: u64 = 86_400_000_000_000;
    let is_near = |nanos: i64| u64::try_from(nanos).is_ok_and(|nanos| nanos.abs_diff(log_time) < DAY_NS);
    if is_near(time) || time <= 1_000_000_000 {
        return None;
    }
    let in_unit = |nanos: &i64| time.checked_mul(*nanos).filter(|time| is_near(*time));
    [1_000_000_000, 1_000_000, 1_000].iter().find_map(in_unit)
}

impl Route {
    /// Passes a piece of a message on to the rod, its samples from number `from` on; returns the time of the first of them, if it
    /// has any, and true if more follow.
    #[inline]
    pub(super) fn take(
        &self,
        (rod, count): (&mut Rod, &mut Count),
        (message, from): (&Message<'_>, usize),
        file: Option<&Arc<str>>,
        scratch: &mut Vec<f64>,
    ) -> Result<(Option<Timestamp>, bool), DecodeError> {
        let channel = match &rod.config.temperature {
            Some(channel) if self.temperature => channel,
            _ => &rod.config.displacement,
        };
        count.messages += u64::from(!self.temperature && from == 0);
        scratch.clear();
        let decoder = self.decoder.as_ref().map_err(Clone::clone)?;
        let Decoded { array, samples, time } = decoder.decode(message.data, from, scratch)?;
        let has_more = samples.saturating_sub(from) > PIECE;
        if from > 0 && scratch.is_empty() {
            return Ok((None, false));
        }
        let time = match (time, &channel.time) {
            (Time::Nanos(nanos), _) => nanos,
            (Time::Outside, stamped) => {
                let nanos = match stamped {
                    TimeSource::Publish => message.publish_time,
                    TimeSource::Log | TimeSource::Field(_) => message.log_time,
                };
                i64::try_from(nanos).map_err(|_| DecodeError::Stamp { nanos })?
            }
        };
        let time = Timestamp::from_nanos(of_coarser_unit(time, message.log_time).unwrap_or(time));
        let unit = channel.unit;
        // Of an array the rate is known, or it is refused.
        let time = channel
            .fs_hz
            .filter(|_| from > 0)
            .map_or(time, |fs_hz| time.plus_seconds(from as f64 / fs_hz));
        if self.temperature {
            for &raw in scratch.iter() {
                rod.assembler.push_temperature(time, unit.convert(raw));
            }
            return Ok((None, has_more));
        }
        if array && channel.fs_hz.is_none() {
            return Err(DecodeError::Rate {
                path: channel.field.clone(),
            });
        }
        for sample in scratch.iter_mut() {
            *sample = unit.convert(*sample);
        }
        count.samples += scratch.len() as u64;
        rod.files.note(file, time);
        rod.assembler.push(time, scratch);
        Ok((Some(time), has_more))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_in_a_coarser_unit_is_known_by_the_time_of_its_log() {
        let six = 1_772_344_800_000_000_000;
        let logged = six as u64 + 3_600_000_000_000;
        for unit in [1_000_000_000, 1_000_000, 1_000] {
            assert_eq!(of_coarser_unit(six / unit, logged), Some(six), "{unit}");
            // Two days on, it may count nanoseconds of a clock that nobody set.
            assert_eq!(
                of_coarser_unit(six / unit, logged + 172_800_000_000_000),
                None,
                "{unit}"
            );
        }
        assert_eq!(of_coarser_unit(six, logged), None);
        assert_eq!(of_coarser_unit(5, 0), None);
    }
}
