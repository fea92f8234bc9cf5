//! One row of a motion: of a rod's sensors in files of their own the first that is read gives it, and what the others have of the same
//! time is refused. Two rows would count one motion twice.

use crate::analysis::identify::{Identification, LeftOut, Sensors};
use crate::analysis::outcome::{Outcome, Rejected};
use crate::analysis::signal::record::{Rejection, Timestamp};

/// Start and length \[s\] of a record.
pub type Span = (Timestamp, f64);

/// The span of a result of a rod with several sensors; `None` for any other.
pub fn span(outcome: &Outcome) -> Option<Span> {
    let Outcome::Identified(found) = outcome else {
        return None;
    };
    found.joint.as_ref()?;
    let measurement = found.measurement.as_ref()?;
    Some((measurement.start, measurement.duration_s))
}

/// A result whose motion has its row, refused; any other outcome as it is.
pub fn late(outcome: &Outcome) -> Outcome {
    match outcome {
        Outcome::Identified(found) => Outcome::Rejected(Box::new(refused(found))),
        other => other.clone(),
    }
}

fn refused(found: &Identification) -> Rejected {
    let unused = |sensor: &String| LeftOut {
        sensor: sensor.clone(),
        why: "its motion has a row already".to_owned(),
    };
    Rejected {
        readings: (found.measurement.as_ref()).map_or_else(Vec::new, |measured| measured.readings.clone()),
        sensors: found.joint.as_ref().map(|joint| Sensors {
            used: Vec::new(),
            left_out: joint.sensors.used.iter().map(unused).collect(),
        }),
        ..Rejected::of_identified(found, Rejection::LateSensor)
    }
}
