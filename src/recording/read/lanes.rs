//! Events of a rod's sensors, each of which is read as a lane of its own: of one sensor as they are, of several as moments.

use super::route::Rod;
use std::sync::Arc;
use tirante_analysis::signal::record::{Event, Moment, Timestamp};

/// An event of a rod, complete at a time, with the file that holds its last sample where several are read as one.
pub(super) type Found = (Timestamp, Event, Option<Arc<str>>);

/// Moves the events of a rod's lanes to `to`; with `all`, none waits for another sensor any more.
pub(super) fn collect(lanes: &mut [Rod], all: bool, to: &mut Vec<Found>) {
    let [first, ..] = lanes else { return };
    let Some(mut moments) = first.moments.take() else {
        for Rod { assembler, files, .. } in lanes {
            to.extend(assembler.timed_events().map(|(at, event)| {
                let origin = files.of(&event);
                (at, event, origin)
            }));
        }
        return;
    };
    let (mut readings, mut alone) = (Vec::new(), Vec::new());
    for (
        sensor,
        Rod {
            assembler,
            is_followed,
            ..
        },
    ) in lanes.iter_mut().enumerate()
    {
        for (at, event) in assembler.timed_events() {
            match event {
                Event::Readings { .. } => readings.push((sensor, at, event)),
                event => alone.extend(moments.push(sensor, at, event)),
            }
        }
        match (assembler.pending_from(), assembler.complete_until()) {
            (Some(from), Some(until)) => moments.note(sensor, from, until),
            _ if *is_followed => moments.end(sensor),
            // Not heard yet.
            _ => {}
        }
    }
    // Of a rod whose sensors all ended nothing is to come.
    let all = all || lanes.iter().all(|lane| lane.assembler.complete_until().is_none());
    alone.extend(std::iter::from_fn(|| moments.next(all)));
    to.extend(alone.into_iter().map(|moment| found(lanes, moment)));
    // Every lane has the rod's readings.
    for (sensor, at, event) in readings {
        if matches!(&event, Event::Readings { readings, .. } if moments.takes_readings(sensor, readings)) {
            let origin = lanes[sensor].files.of(&event);
            to.push((at, event, origin));
        }
    }
    lanes[0].moments = Some(moments);
}

/// Closes the next moment to make room, whatever may still come.
pub(super) fn release(lanes: &mut [Rod]) -> Option<Found> {
    let moment = lanes.first_mut()?.moments.as_mut()?.release()?;
    Some(found(lanes, moment))
}

/// A moment with the file that holds the end of what its first sensor gave.
fn found(lanes: &[Rod], (at, moment): (Timestamp, Moment)) -> Found {
    let first = moment.seen.first();
    let origin = first.and_then(|(sensor, event)| lanes.get(*sensor)?.files.of(event));
    (at, Event::Moment(moment), origin)
}
