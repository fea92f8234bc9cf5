//! Turns TDMS objects into signals: names, units, times.

use super::Groups;
use super::metadata::{Object, Objects, Property};
use crate::import::stamp::{self, TimeUnit};
use crate::import::{ImportError, Signal, Stamps, Timing, is_time_name};
use std::collections::HashMap;
use std::sync::Arc;
use tirante_analysis::signal::record::Timestamp;

/// Relative error of a step that is stored as a double.
const ROUNDING: f64 = 1e-9;

/// The channels with numbers. Stamps are those of the same group: of the channel called `time`, or of one
/// named as a time.
pub(super) fn signals(
    objects: Objects,
    mut skipped: Vec<String>,
    time: Option<&str>,
    find_time: bool,
    unit: Option<TimeUnit>,
) -> Result<Groups, ImportError> {
    let mut groups: Vec<String> = Vec::new();
    let mut channels: Vec<Object> = Vec::new();
    for object in objects.all {
        let [group, _] = &object.path[..] else { continue };
        if object.is_passed_over {
            skipped.push(format!("{} (no real numbers)", object.named()));
            continue;
        }
        if object.values.is_empty() && object.stamps.is_empty() {
            skipped.push(format!("{} (no samples)", object.named()));
            continue;
        }
        if !groups.contains(group) {
            groups.push(group.clone());
        }
        channels.push(object);
    }
    let is_time = |object: &Object| match (time, &object.path[..]) {
        (Some(name), [group, channel]) => channel == name || format!("{group}/{channel}") == name,
        (None, [_, channel]) => find_time && (!object.stamps.is_empty() || is_time_name(channel)),
        _ => false,
    };
    let mut stamps: HashMap<String, Arc<Stamps>> = HashMap::new();
    let mut rest = Vec::new();
    for object in channels {
        let group = object.path.first().cloned().unwrap_or_default();
        // With a step of their own the samples need no stamps.
        if is_time(&object) && !stamps.contains_key(&group) {
            stamps.insert(group, Arc::new(stamps_of(object, unit)?));
        } else {
            rest.push(object);
        }
    }
    if let (Some(name), true) = (time, stamps.is_empty()) {
        let known: Vec<String> = rest.iter().map(Object::named).collect();
        return Err(ImportError::new(format!(
            "no channel {name:?}; there is: {}",
            known.join(", ")
        )));
    }
    let mut found = Groups {
        signals: Vec::new(),
        skipped,
    };
    for object in rest {
        if !object.stamps.is_empty() {
            found.skipped.push(format!("{} (stamps)", object.named()));
            continue;
        }
        if is_unscaled(&object) {
            return Err(ImportError::at(
                object.named(),
                "holds numbers of the hardware with a scale beside them, which is not applied: log with \"scaled data\", or export \
                 it as text",
            ));
        }
        let [group, channel] = &object.path[..] else {
            continue;
        };
        let name = match groups.len() {
            1 => channel.clone(),
            _ => format!("{group}/{channel}"),
        };
        let timing = timing(&object, stamps.get(group));
        let unit = object.text("unit_string").or(object.text("NI_UnitDescription"));
        found.signals.push(Signal {
            name,
            number: found.signals.len() + 1,
            unit: unit
                .map(str::trim)
                .filter(|unit| !unit.is_empty())
                .map(str::to_owned),
            timing,
            values: object.values,
        });
    }
    if found.signals.is_empty() {
        return Err(ImportError::new(format!(
            "holds no channel of numbers{}",
            match found.skipped.is_empty() {
                true => String::new(),
                false => format!(" (but {})", found.skipped.join("; ")),
            }
        )));
    }
    Ok(found)
}

/// True if its numbers still need scaling.
fn is_unscaled(object: &Object) -> bool {
    object.text("NI_Scaling_Status") == Some("unscaled")
        && object
            .number("NI_Number_Of_Scales")
            .is_some_and(|scales| scales > 0.0)
}

fn timing(object: &Object, stamps: Option<&Arc<Stamps>>) -> Timing {
    let step_s = object
        .number("wf_increment")
        .filter(|step| step.is_finite() && *step > 0.0);
    let fs_hz = step_s.map(|step| 1.0 / step).filter(|fs_hz| fs_hz.is_finite());
    let own = stamps.filter(|stamps| stamps.nanos.len() == object.values.len());
    // Stamps count more than a step that contradicts them: single points are written with the default step of 1.
    let contradicts = |fs_hz: f64| own.is_some_and(|stamps| !has_step(stamps, 1e9 / fs_hz));
    if let Some(fs_hz) = fs_hz.filter(|fs_hz| !contradicts(*fs_hz)) {
        let start = match object.properties.get("wf_start_time") {
            // Waveforms without a time of their own begin in 1904.
            Some(Property::Stamp(nanos)) if *nanos > 0 => Some(Timestamp::from_nanos(*nanos)),
            _ => None,
        };
        let offset_s = object
            .number("wf_start_offset")
            .filter(|offset| offset.is_finite());
        return Timing::Rate {
            fs_hz,
            rounding: ROUNDING,
            start: start.map(|start| start.plus_seconds(offset_s.unwrap_or(0.0))),
        };
    }
    own.map_or(Timing::Unknown, |stamps| Timing::Stamps(Arc::clone(stamps)))
}

/// True if the stamps rise by this step in the middle, to a thousandth.
fn has_step(stamps: &Stamps, step_ns: f64) -> bool {
    let mut steps: Vec<i64> = stamps
        .nanos
        .windows(2)
        .map(|pair| pair[1].saturating_sub(pair[0]))
        .collect();
    steps.sort_unstable();
    let resolution_ns = stamps.resolution_ns.max(1) as f64;
    steps
        .get(steps.len() / 2)
        .is_none_or(|middle| (*middle as f64 - step_ns).abs() <= resolution_ns.max(1e-3 * step_ns))
}

fn stamps_of(object: Object, unit: Option<TimeUnit>) -> Result<Stamps, ImportError> {
    if object.stamps.is_empty() {
        return stamp::from_numbers(&object.named(), &object.values, unit);
    }
    Ok(Stamps {
        nanos: object.stamps,
        absolute: true,
        resolution_ns: 1,
        says_unit: true,
        lines: Vec::new(),
    })
}
