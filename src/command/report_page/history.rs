//! Figures over time: absolute force, relative force with temperature, frequencies, charts.

use super::axis::{self, Tick};
use super::decimate::{self, Point};
use super::figure::{COLUMNS, Figure};
use super::markup::Markup;
use super::view::{RecordPoint, RodReport, unix_s};
use crate::analysis::track::Interval;

/// Most points drawn as dots with intervals; more are drawn as a line with a band.
const FEW: usize = 80;
/// Colours of the modes, by order.
const MODE_COLOURS: [&str; 6] = ["c1", "c2", "c3", "c4", "c5", "c6"];
/// Upper end of a chart, in multiples of its limit.
const BEYOND_LIMIT: f64 = 2.0;

/// Least evidence drawn, as a share of the limit.
const LEAST_EVIDENCE: f64 = 1e-5;
const TIME: &str = "time (UTC)";

/// Time axis shared by all histories of one rod.
#[derive(Debug, Clone)]
pub(super) struct Span {
    ends: (f64, f64),
    ticks: Vec<Tick>,
}

impl Span {
    /// From the first to the last record; `None` without records.
    pub fn of(rod: &RodReport) -> Option<Self> {
        let records = rod.records.iter().map(|record| unix_s(record.start));
        let alarms = rod.alarms.iter().map(|alarm| unix_s(alarm.raised));
        let (low, high) = axis::span(records.chain(alarms), 0.0)?;
        let margin = (0.01 * (high - low)).max(600.0);
        let ends = (low - margin, high + margin);
        Some(Self {
            ends,
            ticks: axis::dates(ends, 8),
        })
    }
}

fn series(rod: &RodReport, value: impl Fn(&RecordPoint) -> Option<Interval>) -> Vec<Point> {
    let points = rod.records.iter().filter_map(|record| {
        let interval = value(record)?;
        Some(Point {
            time: unix_s(record.start),
            value: interval.mean,
            interval: (interval.q025, interval.q975),
        })
    });
    points.collect()
}

fn scaled(interval: Interval, factor: f64, shift: f64) -> Interval {
    Interval {
        mean: interval.mean * factor + shift,
        sd: interval.sd * factor,
        q025: interval.q025 * factor + shift,
        q975: interval.q975 * factor + shift,
    }
}

/// A series with its intervals: dots with bars while there are few, else a line in a band.
fn draw(figure: &mut Figure, class: &str, points: &[Point], span: &Span, with_interval: bool) {
    let columns = decimate::columns(points, span.ends, COLUMNS);
    let ends = |column: &decimate::Column| (column.time, column.interval.0, column.interval.1);
    if columns.len() <= FEW {
        if with_interval {
            figure.bars(class, &columns.iter().map(ends).collect::<Vec<_>>());
        }
        figure.dots(class, columns.iter().map(|column| (column.time, column.mean)));
        return;
    }
    if columns.iter().any(|column| column.count > 1) {
        let extremes: Vec<_> = columns
            .iter()
            .map(|column| (column.time, column.extremes.0, column.extremes.1))
            .collect();
        figure.bars(&format!("{class} faint"), &extremes);
    }
    for part in decimate::without_gaps(&columns) {
        if with_interval {
            figure.band(class, &part.iter().map(ends).collect::<Vec<_>>());
        }
        if part.len() == 1 {
            figure.dots(class, part.iter().map(|column| (column.time, column.mean)));
        }
        figure.line(class, part.iter().map(|column| (column.time, column.mean)));
    }
}

/// The vertical span: the bulk of intervals and all values.
fn vertical(series: &[&[Point]], always: &[f64]) -> (f64, f64) {
    let values = series
        .iter()
        .flat_map(|points| points.iter().map(|point| point.value));
    let mut low: Vec<f64> = series
        .iter()
        .flat_map(|p| p.iter().map(|point| point.interval.0))
        .collect();
    let mut high: Vec<f64> = series
        .iter()
        .flat_map(|p| p.iter().map(|point| point.interval.1))
        .collect();
    low.sort_by(f64::total_cmp);
    high.sort_by(f64::total_cmp);
    // A single record with a huge interval must not flatten the whole history.
    let bulk = [
        low.get(low.len() / 50),
        high.get(high.len().saturating_sub(1 + high.len() / 50)),
    ];
    let all = values
        .chain(bulk.into_iter().flatten().copied())
        .chain(always.iter().copied());
    axis::span(all, 0.06).unwrap_or((0.0, 1.0))
}

/// Marks the baseline's stretch and the alarms.
fn mark(figure: &mut Figure, rod: &RodReport) {
    for segment in &rod.segments {
        if let Some((first, last)) = segment.baseline {
            figure.stretch("baseline", unix_s(first), unix_s(last), "baseline");
        }
    }
    for alarm in &rod.alarms {
        if let Some(change) = &alarm.change {
            figure.stretch("onset", unix_s(change.onset_q025), unix_s(change.onset_q975), "");
        }
        let class = if alarm.is_over() { "alarm over" } else { "alarm" };
        figure.event(class, unix_s(alarm.raised), alarm.kind.code());
    }
}

/// Absolute force over time \[kN\].
pub(super) fn absolute_force(rod: &RodReport, span: &Span, id: &str) -> Option<Markup> {
    let single = series(rod, |record| Some(scaled(record.force_n, 1e-3, 0.0)));
    let tracked = series(rod, |record| Some(scaled(record.tracked_force_n?, 1e-3, 0.0)));
    if single.is_empty() {
        return None;
    }
    let y = vertical(&[&single, &tracked], &[]);
    let mut figure = Figure::new(span.ends, y, 200.0);
    figure.x_axis(&span.ticks, TIME);
    figure.y_axis(&axis::numbers(y, 5), "axial force [kN]");
    mark(&mut figure, rod);
    draw(&mut figure, "c7", &single, span, true);
    draw(&mut figure, "c1", &tracked, span, true);
    figure.key("c7", "each record by itself, 95 %");
    if !tracked.is_empty() {
        figure.key("c1", "all records together, 95 %");
    }
    let title = format!("Axial force of rod {} over time", rod.rod);
    Some(figure.finish(id, &title, "Axial force in kilonewtons against time, with 95 % credible bands; the tables beside give the latest values."))
}

/// Relative force over time \[%\].
pub(super) fn relative_force(rod: &RodReport, span: &Span, id: &str) -> Option<Markup> {
    let percent = |interval: Interval| scaled(interval, 100.0, -100.0);
    let measured = series(rod, |record| record.ratio.map(percent));
    let referred = series(rod, |record| record.ratio_at_reference.map(percent));
    if measured.is_empty() {
        return None;
    }
    let y = vertical(&[&measured, &referred], &[0.0]);
    let mut figure = Figure::new(span.ends, y, 240.0);
    figure.x_axis(&span.ticks, TIME);
    figure.y_axis(&axis::numbers(y, 6), "change of force [%]");
    mark(&mut figure, rod);
    figure.level("zero", 0.0, "");
    draw(&mut figure, "c7", &measured, span, referred.is_empty());
    draw(&mut figure, "c1", &referred, span, true);
    figure.key("c7", "as measured");
    if referred.is_empty() {
        figure.key("c7", "uncompensated");
    } else {
        figure.key("c1", "at the reference temperature, 95 %");
    }
    let title = format!("Change of axial force of rod {} since the baseline", rod.rod);
    Some(figure.finish(id, &title, "Relative change of force in percent against time, as measured and referred to one temperature, with 95 % credible bands; baseline shaded, alarms marked."))
}

/// Temperature over the same time \[degC\].
pub(super) fn temperature(rod: &RodReport, span: &Span, id: &str) -> Option<Markup> {
    let points: Vec<Point> = rod
        .records
        .iter()
        .filter_map(|record| {
            let value = record.temperature_c?;
            Some(Point {
                time: unix_s(record.start),
                value,
                interval: (value, value),
            })
        })
        .collect();
    if points.is_empty() {
        return None;
    }
    let reference = rod.segment().and_then(|segment| segment.reference_c);
    let y = vertical(&[&points], reference.as_slice());
    let mut figure = Figure::new(span.ends, y, 90.0);
    figure.x_axis(&span.ticks, TIME);
    figure.y_axis(&axis::numbers(y, 3), "air [\u{b0}C]");
    draw(&mut figure, "c2", &points, span, false);
    if let Some(reference) = reference {
        figure.level("zero", reference, "reference");
    }
    let title = format!("Temperature beside rod {}", rod.rod);
    Some(figure.finish(
        id,
        &title,
        "Temperature in degrees Celsius against the same time axis.",
    ))
}

/// Frequencies over time, relative to each mode's median \[%\].
pub(super) fn frequencies(rod: &RodReport, span: &Span, id: &str) -> Option<Markup> {
    let mut orders: Vec<usize> = rod
        .records
        .iter()
        .flat_map(|r| r.modes.iter().map(|mode| mode.0))
        .collect();
    orders.sort_unstable();
    orders.dedup();
    let modes: Vec<(usize, f64, Vec<Point>)> = orders
        .into_iter()
        .filter_map(|order| {
            let measured = rod.records.iter().filter_map(|record| {
                let (_, hz, sd) = record.modes.iter().find(|mode| mode.0 == order)?;
                Some((unix_s(record.start), *hz, *sd))
            });
            let measured: Vec<(f64, f64, f64)> = measured.collect();
            let mut sorted: Vec<f64> = measured.iter().map(|m| m.1).collect();
            sorted.sort_by(f64::total_cmp);
            let median = *sorted.get(sorted.len() / 2)?;
            let percent = |hz: f64| 100.0 * (hz / median - 1.0);
            let points = measured
                .iter()
                .map(|&(time, hz, sd)| Point {
                    time,
                    value: percent(hz),
                    interval: (percent(hz - 1.96 * sd), percent(hz + 1.96 * sd)),
                })
                .collect();
            Some((order, median, points))
        })
        .collect();
    if modes.is_empty() {
        return None;
    }
    let all: Vec<&[Point]> = modes.iter().map(|mode| mode.2.as_slice()).collect();
    let y = vertical(&all, &[0.0]);
    let mut figure = Figure::new(span.ends, y, 180.0);
    figure.x_axis(&span.ticks, TIME);
    figure.y_axis(&axis::numbers(y, 5), "frequency, change [%]");
    mark(&mut figure, rod);
    for (order, median, points) in &modes {
        let class = MODE_COLOURS[(order - 1) % MODE_COLOURS.len()];
        draw(&mut figure, class, points, span, points.len() <= FEW);
        figure.key(class, &format!("mode {order}: {median:.3} Hz"));
    }
    let title = format!("Natural frequencies of rod {} over time", rod.rod);
    Some(figure.finish(
        id,
        &title,
        "Each natural frequency's deviation from its median in percent against time.",
    ))
}

/// Evidence of a change over its limit, as a power of ten, by the best-informed detector of each period.
pub(super) fn evidence(rod: &RodReport, span: &Span, id: &str) -> Option<Markup> {
    let points: Vec<Point> = rod
        .periods
        .iter()
        .filter_map(|(_, period)| {
            let evidence = period.charted.as_ref()?.evidence;
            let over_limit = evidence.compensated.or(evidence.peers).or(evidence.blind)?;
            let value = over_limit
                .max(LEAST_EVIDENCE)
                .log10()
                .clamp(LEAST_EVIDENCE.log10(), BEYOND_LIMIT);
            Some(Point {
                time: unix_s(period.start),
                value,
                interval: (value, value),
            })
        })
        .collect();
    if points.is_empty() {
        return None;
    }
    let y = (LEAST_EVIDENCE.log10(), BEYOND_LIMIT);
    let mut figure = Figure::new(span.ends, y, 150.0);
    figure.x_axis(&span.ticks, TIME);
    figure.y_axis(&axis::numbers(y, 5), "log10(evidence / limit)");
    mark(&mut figure, rod);
    figure.level("limit", 0.0, "alarm");
    let columns = decimate::columns(&points, span.ends, COLUMNS);
    // Of a crowded column the highest counts.
    for part in decimate::without_gaps(&columns) {
        figure.line("c1", part.iter().map(|column| (column.time, column.extremes.1)));
    }
    if columns.len() <= FEW {
        figure.dots(
            "c1",
            columns.iter().map(|column| (column.time, column.extremes.1)),
        );
    }
    let title = format!("Evidence of a change, rod {}", rod.rod);
    Some(figure.finish(
        id,
        &title,
        "Evidence of a change of force over its limit on a logarithmic scale against time; an alarm where it is above zero.",
    ))
}
