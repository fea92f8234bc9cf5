//! Events of a rod's sensors, each of which is read as a lane of its own: of one sensor as they are, of several as moments.

use super::route::Rod;
use crate::analysis::signal::record::{Event, Timestamp};
use std::sync::Arc;

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
    let mut readings = Vec::new();
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
                event => to.extend(
                    moments
                        .push(sensor, at, event)
                        .map(|(at, moment)| (at, Event::Moment(moment), None)),
                ),
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
    while let Some((at, moment)) = moments.next(all) {
        let seen = moment.seen.first();
        let origin = seen.and_then(|(sensor, event)| lanes.get(*sensor)?.files.of(event));
        to.push((at, Event::Moment(moment), origin));
    }
    // Every lane has the rod's readings: those count that go on where the latest moment's end.
    let going_on = readings
        .into_iter()
        .filter(|(sensor, ..)| moments.gives_temperature(*sensor));
    to.extend(going_on.map(|(_, at, event)| (at, event, None)));
    lanes[0].moments = Some(moments);
}

/// Closes the next moment to make room, whatever may still come.
pub(super) fn release(lanes: &mut [Rod], to: &mut Vec<Found>) {
    let moments = lanes.first_mut().and_then(|first| first.moments.as_mut());
    if let Some((at, moment)) = moments.and_then(|moments| moments.next(true)) {
        to.push((at, Event::Moment(moment), None));
    }
}
