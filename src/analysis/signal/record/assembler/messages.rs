//! Puts messages in order: duplicates, late ones, and those stamped late.

use super::{Ahead, Assembler, LATE, MAX_ASIDE, Message, bytes_of};
use crate::signal::record::{clock, timing};
use std::collections::VecDeque;

/// Messages needed to measure the sample interval.
const WARM: usize = 16;
/// Most messages that do not fit before they start a new stretch.
const ASTRAY: usize = 3;
/// Messages ahead from which a message may have overtaken others; below, it is stamped late.
const AHEAD: f64 = 1.75;
/// Scatter of the stamps, over the message interval, above which messages keep their order of arrival.
const WOBBLY: f64 = 0.04;

/// Place of one message relative to the running stretch.
pub(super) enum Place {
    Next,
    Late(usize),
    /// Next, and the message before it was stamped late.
    Corrects,
    Duplicate,
    Astray,
}

impl Assembler {
    pub(super) fn take(&mut self, (time, values): Message, queue: &mut VecDeque<Message>) {
        if self.interval.is_none() {
            self.warm.push((time, values));
            let is_much = self.warm.len() > 1 && bytes_of(&self.warm) > MAX_ASIDE;
            if self.warm.len() >= WARM || is_much {
                self.warmed(queue);
            }
            return;
        }
        self.untangle(time, values.len());
        self.adopt(time, values.len());
        match self.place(time, &values) {
            Some(Place::Next) => self.append(time, &values),
            Some(Place::Late(back)) => self.put_before(back, time, &values),
            Some(Place::Corrects) => {
                self.set_last_right();
                self.append(time, &values);
            }
            Some(Place::Duplicate) => {
                self.dropped += values.len();
                return;
            }
            Some(Place::Astray) | None => {
                self.astray.push((time, values));
                let is_much = self.astray.len() > 1 && bytes_of(&self.astray) > MAX_ASIDE;
                if self.astray.len() > ASTRAY || is_much {
                    self.cut_rest();
                    let open = std::mem::take(&mut self.open);
                    self.close(open, false, None);
                    self.seen_until = i64::MIN;
                    self.interval = None;
                    self.warm = std::mem::take(&mut self.astray);
                }
                return;
            }
        }
        // It fits: messages put aside may fit now, or were a slip of the clock.
        for (time, values) in std::mem::take(&mut self.astray) {
            match self.place(time, &values) {
                Some(Place::Next) => self.append(time, &values),
                Some(Place::Late(back)) => self.put_before(back, time, &values),
                _ => self.dropped += values.len(),
            }
        }
    }

    /// Inserts a late message, and notes if the message after it may be stamped late.
    fn put_before(&mut self, back: usize, time: i64, values: &[f64]) {
        if let [.., before, last] = self.open.times[..]
            && back == 1
            && self.ahead.is_none()
            && let Some(end) = self.end_of(self.open.times.len() - 2)
        {
            // Otherwise it fills the hole, and the last one was ahead by one.
            if time as f64 - end > 0.5 * self.unit(values.len()) {
                self.ahead = Some(Ahead {
                    time: last,
                    behind: before,
                });
            }
        }
        self.open.insert(back, time, values);
    }

    /// Handles a message at the stamp of the stretch's last one while the hole before that one is still open:
    /// the last one was stamped late and moves back to its place of arrival.
    fn untangle(&mut self, time: i64, samples: usize) {
        let (Some(ahead), Some(interval)) = (self.ahead, self.interval) else {
            return;
        };
        // A cut may have taken it away.
        let last = self.open.times.len().saturating_sub(1);
        let (true, Some(due)) = (
            self.open.times.last() == Some(&ahead.time),
            last.checked_sub(1).and_then(|at| self.end_of(at)),
        ) else {
            self.ahead = None;
            return;
        };
        let unit = self.unit(samples);
        let fits_before = time as f64 + unit <= ahead.time as f64 + 0.25 * unit;
        if fits_before {
            return;
        }
        self.ahead = None;
        let is_in_its_way = (time as f64 - due).abs() < 0.5 * unit;
        let known = &self.open.times[..last];
        let origin = known
            .iter()
            .rposition(|&time| time <= ahead.behind)
            .filter(|&at| known[at] == ahead.behind);
        let (true, Some(origin)) = (is_in_its_way, origin) else {
            return;
        };
        let (size, end) = (self.open.sizes[last], self.end_of(origin));
        let length = interval * f64::from(size);
        if let (Some(end), Some(&next)) = (end, known.get(origin + 1))
            && next as f64 - end > 0.5 * length
        {
            let values = self.open.pop();
            self.stray.count(ahead.time as f64 - end);
            self.open.insert(last - origin - 1, end.round() as i64, &values);
        }
    }

    /// Adopts the messages set aside if this one comes where it would after them: their stamps were wrong.
    fn adopt(&mut self, time: i64, samples: usize) {
        let (false, Some(interval)) = (self.astray.is_empty(), self.interval) else {
            return;
        };
        let Some(end) = self
            .open
            .times
            .len()
            .checked_sub(1)
            .and_then(|last| self.end_of(last))
        else {
            return;
        };
        let aside: usize = self.astray.iter().map(|(_, values)| values.len()).sum();
        let due = end + interval * aside as f64;
        if (time as f64 - due).abs() > 0.25 * self.unit(samples) + 3.0 * self.wobble {
            return;
        }
        let mut right = end;
        for (stamp, values) in std::mem::take(&mut self.astray) {
            self.stray.count(stamp as f64 - right);
            self.append(right.round() as i64, &values);
            right += self.unit(values.len());
        }
    }

    /// Sets the last message's stamp to the end of the one before it.
    fn set_last_right(&mut self) {
        let last = self.open.times.len().checked_sub(1);
        if let Some(last) = last
            && let Some(end) = last.checked_sub(1).and_then(|at| self.end_of(at))
        {
            self.stray.count(self.open.times[last] as f64 - end);
            self.open.times[last] = end.round() as i64;
        }
    }

    /// End of message `at` of the stretch \[ns\].
    fn end_of(&self, at: usize) -> Option<f64> {
        let (&time, &size) = (self.open.times.get(at)?, self.open.sizes.get(at)?);
        Some(time as f64 + self.unit(size as usize))
    }

    /// Duration of a number of samples \[ns\].
    fn unit(&self, samples: usize) -> f64 {
        self.interval.unwrap_or(0.0) * samples as f64
    }

    /// Starts a new stretch once there are enough messages to know the sample interval.
    pub(super) fn warmed(&mut self, queue: &mut VecDeque<Message>) {
        let warm = std::mem::take(&mut self.warm);
        let mut order: Vec<(i64, u32)> = warm
            .iter()
            .map(|(time, values)| (*time, values.len() as u32))
            .collect();
        order.sort_unstable();
        let (times, sizes): (Vec<i64>, Vec<u32>) = order.into_iter().unzip();
        let declared = self.declared_hz.map(|fs_hz| 1e9 / fs_hz);
        // Stamps that do not advance leave one nanosecond; the stretch is refused when it is closed.
        let interval = timing::interval(&times, &sizes).or(declared).unwrap_or(1.0);
        self.interval = Some(interval);
        let mut off: Vec<f64> = warm
            .windows(2)
            .map(|pair| {
                let length = interval * pair[0].1.len() as f64;
                (pair[1].0.saturating_sub(pair[0].0) as f64 - length).abs()
            })
            .collect();
        self.wobble = if off.len() < WARM / 2 {
            0.0
        } else {
            clock::GAUSSIAN * clock::median(&mut off) / std::f64::consts::SQRT_2
        };
        for message in warm.into_iter().rev() {
            queue.push_front(message);
        }
    }

    #[inline]
    pub(super) fn place(&self, time: i64, values: &[f64]) -> Option<Place> {
        let interval = self.interval?;
        let (Some(&last), Some(&size)) = (self.open.times.last(), self.open.sizes.last()) else {
            return Some(Place::Next);
        };
        let length = interval * f64::from(size);
        let unit = interval * values.len() as f64;
        // Nanoseconds between the end of the last message and this one.
        let hole = time.saturating_sub(last) as f64 - length;
        // Batches may not overlap by much; single samples only have to advance.
        if time > last && (size == 1 || hole > -0.5 * length.max(unit) - 1.0) {
            let limit = (self.settings.max_gap_s * 1e9).max(0.5 * unit);
            return Some(if hole > limit { Place::Astray } else { Place::Next });
        }
        Some(self.place_late(time, values, interval))
    }

    /// Place of a message from the past: late if there is a hole for it, known if it is a duplicate, next if
    /// the stamps scatter widely or the last one was late.
    fn place_late(&self, time: i64, values: &[f64], interval: f64) -> Place {
        let open = &self.open;
        let count = open.times.len();
        let oldest = count.saturating_sub(LATE);
        let same = open.times[oldest..].iter().rposition(|&known| known == time);
        let at = oldest + same.unwrap_or_else(|| open.times[oldest..].partition_point(|&known| known < time));
        if same.is_some() {
            let younger: usize = open.sizes[at..].iter().map(|&size| size as usize).sum();
            let first = open.values.len() - younger;
            let known = open.values.get(first..first + open.sizes[at] as usize);
            let same = known.is_some_and(|known| {
                known.len() == values.len()
                    && known.iter().zip(values).all(|(a, b)| a.to_bits() == b.to_bits())
            });
            // A message that waited for the clock line is stamped at once.
            let waited = at + 1 == count && open.sizes[at] == 1 && values.len() == 1;
            return match (same, waited) {
                (true, _) => Place::Duplicate,
                (false, true) => Place::Next,
                (false, false) => Place::Astray,
            };
        }
        let unit = interval * values.len() as f64;
        let last = (count - 1, open.times[count - 1] as f64);
        let last_length = interval * f64::from(open.sizes[last.0]);
        // By as much as two stamps may differ.
        let early = last.1 + last_length - time as f64;
        if self.wobble > WOBBLY * last_length && early < 1.25 * last_length + 8.0 * self.wobble {
            return Place::Next;
        }
        if let Some(end) = last.0.checked_sub(1).and_then(|before| self.end_of(before)) {
            let due = end + last_length;
            let is_due = (time as f64 - due).abs() < 0.25 * unit + 3.0 * self.wobble;
            if is_due && last.1 > end && last.1 - end < AHEAD * last_length {
                return Place::Corrects;
            }
        }
        if at == oldest || at == count {
            return Place::Astray;
        }
        let end_before = open.times[at - 1] as f64 + interval * f64::from(open.sizes[at - 1]);
        let fits = time as f64 >= end_before - 0.25 * unit
            && time as f64 + unit <= open.times[at] as f64 + 0.25 * unit;
        if fits {
            Place::Late(count - at)
        } else {
            Place::Astray
        }
    }
}
