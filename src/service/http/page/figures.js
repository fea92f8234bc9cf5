// Data of each plot on a rod's page.

import { degrees, fixed, time } from "./common.js";

const ms = (texts) => texts.map((text) => Date.parse(text));
const scaled = (values, scale) => values.map((value) => (value === null ? null : scale(value)));
const band = (values, scale) => ({ y: scaled(values.mean, scale), low: scaled(values.q025, scale), high: scaled(values.q975, scale) });
const isDrawn = (values) => values.mean.some((value) => value !== null);
const change = (ratio) => 100 * (ratio - 1);
const kN = (newtons) => newtons / 1e3;

// ` at 11.1 °C`, the reference temperature of the present segment.
export const atReference = (rod) => (rod.reference_temperature_c === null ? "at the reference temperature" : `at ${degrees(rod.reference_temperature_c)}`);

// Events of a rod with time, sign and text, for the strip above a plot and the list of events.
export function events(rod, alarms) {
  const list = [];
  const add = (at, symbol, shade, text, more = {}) => at && list.push({ at: Date.parse(at), symbol, shade, text: `${time(at)} UTC: ${text}`, words: text, ...more });
  for (const alarm of alarms) {
    add(alarm.raised, "down", "alarm", `alarm ${alarm.kind}`, { isLine: true, detail: alarm.message });
    add(alarm.acknowledged, "check", "good", `${alarm.kind} acknowledged${alarm.acknowledged_words ? `, ${alarm.acknowledged_words}` : ""}`);
    add(alarm.cleared, "ring", "soft", `condition of ${alarm.kind} ended`);
  }
  const WHY = { first: "first baseline", requested: "new baseline, asked for", changed: "new baseline, the rod's configuration changed", clock: "new baseline, the clock jumped" };
  for (const segment of rod.segments) {
    if (segment.baseline) add(segment.baseline[0], "diamond", "c3", `${WHY[segment.reason] ?? segment.reason}${segment.asked_words ? `: ${segment.asked_words}` : ""}`, { detail: `${segment.baseline_records} records` });
  }
  return list.sort((a, b) => a.at - b.at);
}

// Marks baselines in green and the onset of a drift, with its 95 % interval, in red.
function stretchesOf(rod, alarms) {
  const baselines = rod.segments.map((segment) => segment.baseline).filter(Boolean)
    .map(([from, to]) => ({ from: Date.parse(from), to: Date.parse(to), shade: "c3" }));
  const onsets = alarms.filter((alarm) => alarm.change && alarm.stands)
    .map(({ change }) => ({ from: Date.parse(change.onset_q025), to: Date.parse(change.onset_q975), shade: "alarm", isEdged: true }));
  return [...baselines, ...onsets];
}

export function relative(plot, rod, history, alarms, axis) {
  const x = ms(history.time), series = [], { relative_force_at_reference: reference, relative_force: measured } = history;
  if (isDrawn(reference)) series.push({ key: "reference", name: atReference(rod), shade: "c1", x, ...band(reference, change) });
  if (isDrawn(measured)) series.push({ name: "at the measured temperature", shade: "c2", x, ...band(measured, change), off: series.length > 0 });
  const aside = history.set_aside.map((why, i) => (why && measured.mean[i] !== null ? i : -1)).filter((i) => i >= 0);
  if (aside.length) {
    series.push({ name: "set aside", shade: "soft", symbol: "cross", line: false, x: aside.map((i) => x[i]), y: aside.map((i) => change(measured.mean[i])), notes: aside.map((i) => history.set_aside[i]) });
  }
  const limit = rod.limit_loss === null ? [] : [{ at: -100 * rod.limit_loss, label: `limit of loss ${fixed(100 * rod.limit_loss, 1)} %`, shade: "alarm" }];
  plot.draw({ x: axis, y: { title: "change of force [%]", digits: 2 }, series, levels: limit, stretches: stretchesOf(rod, alarms), events: events(rod, alarms), zoom: axis.zoom });
  return series.length > 0;
}

export function absolute(plot, rod, history, axis) {
  const x = ms(history.time), series = [];
  if (isDrawn(history.axial_force_n)) series.push({ name: "each record alone, at its own temperature", shade: "c4", x, ...band(history.axial_force_n, kN) });
  if (isDrawn(history.force_at_reference_n)) series.push({ key: "reference", name: `given the baseline, ${atReference(rod)}`, shade: "c1", x, ...band(history.force_at_reference_n, kN) });
  if (isDrawn(history.tracked_force_n)) series.push({ name: "given the baseline, at the record's temperature", shade: "c2", x, ...band(history.tracked_force_n, kN), off: isDrawn(history.force_at_reference_n) });
  plot.draw({ x: axis, y: { title: "axial force [kN]", digits: 1 }, series, zoom: axis.zoom });
  return series.length > 0;
}

export function temperature(plot, history, axis) {
  plot.draw({ x: axis, y: { title: "temperature [\u00b0C]", digits: 1 }, series: [{ name: "temperature", shade: "c2", x: ms(history.time), y: history.temperature_c }], zoom: axis.zoom });
  return history.temperature_c.some((value) => value !== null);
}

// Each mode relative to its own median, so that all are visible; the names show the medians.
export function frequencies(plot, answer, axis) {
  const x = ms(answer.time);
  const series = answer.modes.map((mode, n) => {
    const sorted = mode.frequency_hz.filter((f) => f !== null).sort((a, b) => a - b);
    const median = sorted[Math.floor(sorted.length / 2)];
    const away = (f) => 100 * (f / median - 1);
    const edge = (sign) => mode.frequency_hz.map((f, i) => (f === null ? null : away(f + sign * 1.96 * mode.sd_hz[i])));
    return { key: `mode ${mode.order}`, name: `mode ${mode.order}: ${fixed(median, 3)} Hz`, shade: `c${1 + (n % 4)}`, isDashed: n > 3, x, y: scaled(mode.frequency_hz, away), low: edge(-1), high: edge(1),
      saved: { unit: "[Hz]", y: mode.frequency_hz, low: mode.frequency_hz.map((f, i) => f && f - 1.96 * mode.sd_hz[i]), high: mode.frequency_hz.map((f, i) => f && f + 1.96 * mode.sd_hz[i]) } };
  });
  plot.draw({ x: axis, y: { title: "frequency change [%]", digits: 3 }, series, zoom: axis.zoom });
  return series.length > 0;
}

// Force at each record's own temperature over that temperature, with the relation learned.
export function thermal(plot, rod, history, alarms) {
  const force = history.tracked_force_n.mean, { temperature_c: t, relative_force: ratio } = history;
  // The relation is that of the present baseline.
  const learned = rod.segments?.find((segment) => segment.number === rod.segment)?.baseline?.[0];
  const counts = (i) => force[i] !== null && t[i] !== null && !history.set_aside[i] && learned && Date.parse(history.time[i]) >= Date.parse(learned);
  const there = force.map((_, i) => i).filter(counts);
  if (there.length < 2 || !rod.thermal || rod.reference_temperature_c === null) return false;
  const onset = alarms.find((alarm) => alarm.stands && alarm.change)?.change.onset;
  const part = (name, shade, picked) => ({ name, shade, line: false, points: true, x: picked.map((i) => t[i]), y: picked.map((i) => kN(force[i])), notes: picked.map((i) => time(history.time[i])) });
  const isSince = (i) => onset && Date.parse(history.time[i]) >= Date.parse(onset);
  const series = [part(onset ? "before the onset" : "records", "c1", there.filter((i) => !isSince(i)))];
  if (onset) series.push(part("since the onset", "alarm", there.filter(isSince)));
  // The force of the baseline follows from any record: its force over its ratio.
  const baseline = kN(force[there[0]] / ratio.mean[there[0]]);
  const reach = [Math.min(...there.map((i) => t[i])), Math.max(...there.map((i) => t[i]))];
  const xs = [...Array(25).keys()].map((n) => reach[0] + ((reach[1] - reach[0]) * n) / 24);
  const at = (slope) => (celsius) => baseline * (1 + slope * (celsius - rod.reference_temperature_c));
  const { slope_per_k: slope, slope_sd_per_k: sd } = rod.thermal;
  const edges = xs.map((c) => [at(slope - 1.96 * sd)(c), at(slope + 1.96 * sd)(c)].sort((a, b) => a - b));
  series.push({ name: "learned: the baseline's force", shade: "c3", points: false, x: xs, y: xs.map(at(slope)), low: edges.map(([low]) => low), high: edges.map(([, high]) => high) });
  plot.draw({ x: { title: "temperature [\u00b0C]", unit: "\u00b0C", digits: 1, pad: 0.03 }, y: { title: "axial force [kN]", digits: 1 }, series, isClosest: true });
  return true;
}

// Each detector's evidence over its limit, on a logarithmic scale: an alarm is a line that crosses one.
export function charts(plot, chart, axis) {
  const x = ms(chart.time);
  const series = [["temperature and other rods", chart.evidence, "c1"], ["other rods alone", chart.evidence_peers, "c2"], ["this rod alone", chart.evidence_blind, "c3"]]
    .filter(([, values]) => values.some((value) => value !== null))
    .map(([name, values, shade]) => ({ name, shade, x, y: scaled(values, (value) => Math.min(Math.max(value, 1e-5), 1e3)), saved: { y: values } }));
  plot.draw({ x: axis, y: { title: "evidence / limit", isLog: true, range: [-4.2, 3.1] }, series, levels: [{ at: 1, label: "alarm above 1", shade: "alarm" }], zoom: axis.zoom });
  return series.length > 0;
}

export function waveform(plot, waveform, unit) {
  const largest = Math.max(...waveform.high.map(Math.abs), ...waveform.low.map(Math.abs), 1e-30);
  const [factor, prefix] = [[1, ""], [1e3, "m"], [1e6, "\u00b5"], [1e9, "n"]].find(([f]) => largest * f >= 1) ?? [1e9, "n"];
  const x = [], y = [];
  waveform.low.forEach((low, i) => {
    x.push(i * waveform.step_s, (i + 0.5) * waveform.step_s);
    y.push(low * factor, waveform.high[i] * factor);
  });
  plot.draw({ x: { title: "time [s]", unit: "s", digits: 2 }, y: { title: `signal [${prefix}${unit ?? ""}]`, digits: 2 }, series: [{ name: "samples", shade: "c1", points: false, x, y }] });
}

export function spectrum(plot, snapshot) {
  const { first_hz: first, step_hz: step, level_db: level } = snapshot.curve;
  const at = (frequency) => level[Math.min(Math.max(Math.round((frequency - first) / step), 0), level.length - 1)];
  const modes = snapshot.peaks.filter((peak) => peak.order !== null), others = snapshot.peaks.filter((peak) => peak.order === null);
  const points = (peaks, name, symbol, shade, label) => ({ name, shade, symbol, line: false, x: peaks.map((peak) => peak.frequency_hz), y: peaks.map((peak) => at(peak.frequency_hz)), labels: peaks.map(label) });
  const series = [{ name: "power spectral density", shade: "c1", points: false, x: level.map((_, i) => first + i * step), y: level }];
  if (modes.length) series.push(points(modes, "modes", "down", "c3", (peak) => `${peak.order}: ${peak.frequency_hz.toFixed(3)} Hz`));
  const named = (peak) => (peak.line ? "tone" : modes.length ? "" : `${peak.frequency_hz.toFixed(3)} Hz`);
  if (others.length) series.push(points(others, modes.length ? "other peaks" : "peaks", "cross", "soft", named));
  const levels = level.filter((value) => value > -390);
  const top = Math.max(...levels), low = Math.min(...levels);
  plot.draw({ x: { title: "frequency [Hz]", unit: "Hz", digits: 3 }, y: { title: "level [dB]", digits: 1, range: [low - 3, top + 0.22 * (top - low) + 3] }, series, isClosest: true });
}

const UNITS = { axial_force_n: ["axial force [kN]", 1e-3], youngs_modulus_pa: ["Young's modulus [GPa]", 1e-9], density_kg_m3: ["density [kg/m\u00b3]", 1],
  side_m: ["side [mm]", 1e3], diameter_m: ["diameter [mm]", 1e3], width_m: ["width [mm]", 1e3], height_m: ["height [mm]", 1e3], length_m: ["length [m]", 1],
  flexural_rigidity_n_m2: ["flexural rigidity [kN m\u00b2]", 1e-3], mass_per_length_kg_m: ["mass per length [kg/m]", 1],
  spring_left_n_m: ["left support stiffness [kN m/rad]", 1e-3], spring_right_n_m: ["right support stiffness [kN m/rad]", 1e-3],
  fixity_left: ["left fixity [0 hinge, 1 clamp]", 1], fixity_right: ["right fixity [0 hinge, 1 clamp]", 1] };
export const quantity = (key) => UNITS[key] ?? [`${key} [SI]`, 1];

export function density(plot, density) {
  const [title, factor] = quantity(density.quantity);
  const x = density.prior.map((_, i) => factor * (density.low + ((density.high - density.low) * i) / (density.prior.length - 1)));
  plot.draw({ x: { title, digits: 1 }, y: { title: "density", isBare: true, zero: true },
    series: [{ name: "prior", shade: "soft", points: false, x, y: density.prior }, { name: "posterior", shade: "c1", points: false, fill: true, x, y: density.posterior }] });
}
