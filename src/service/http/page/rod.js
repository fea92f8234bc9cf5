// One rod: its forces over time, its charts, its latest record, its records.

import { alarmNote, ask, doubts, el, fixed, force, interval, isAlone, kilonewtons, live, percent, show, state, table, time, why } from "./common.js";
import * as figures from "./figures.js";

const id = new URLSearchParams(location.search).get("id") ?? "";
const base = `/api/v1/rods/${encodeURIComponent(id)}`;
const content = document.getElementById("content");
document.getElementById("title").textContent = id;
document.title = `${id} - Tirante`;

const notes = el("div", {}), facts = el("dl", { class: "facts" });
const relative = figures.figure("relative", "Change of the axial force since the baseline, with its 95 % interval. Green: the baseline; red: an alarm was raised.");
const charts = figures.figure("charts", "Evidence of a change of force over its limit: an alarm is raised where the line crosses 1. The other lines stand in where there is no temperature.", true);
const absolute = figures.figure("absolute", "Axial force with its 95 % interval: from each record alone, and given the baseline.");
const temperature = figures.figure("temperature", "Temperature of the records.", true);
const waveform = figures.figure("waveform", "The latest identified record about its mean.", true);
const spectrum = figures.figure("spectrum", "Power spectral density of the latest identified record, with the modes found.");
const hangsOn = el("div", { id: "hangs-on", hidden: "" });
const density = figures.figure("density", "What the latest record says of one quantity: posterior against prior.");
const choice = el("select", { id: "quantity", onchange: () => drawLatest() });
const latestTitle = el("h2", { id: "latest-title" }, "Latest record");
const latestWords = el("p", { id: "latest-words" });
const refusedTitle = el("h2", { id: "refused-title" }, "Latest rejected record");
const refusedWords = el("div", { id: "refused-words" });
const refusedWaveform = figures.figure("refused-waveform", "The latest rejected record about its mean.", true);
const refusedSpectrum = figures.figure("refused-spectrum", "Power spectral density of the latest rejected record, with its peaks.");
const refusedPeaks = el("div", { id: "refused-peaks" });
const records = el("div", {}), older = el("button", { type: "button", hidden: true, onclick: () => drawRecords(true) }, "older ones");
const rejectedOnly = el("input", { type: "checkbox", id: "rejected", onchange: () => drawRecords() });

// The stretch of time that is shown: the last so many days, everything, or what somebody zoomed to.
let days = 365, zoomed = null, rod = null, alarms = [], latest = null, shown = [], next = null;
const DAY = 86_400_000;

const ranges = [["7 d", 7], ["30 d", 30], ["1 y", 365], ["all", null]].map(([name, length]) =>
  el("button", { type: "button", "data-days": String(length), "aria-pressed": String(length === days), onclick: () => { days = length; zoomed = null; drawHistory(); } }, name));

function stretch() {
  if (zoomed) return zoomed;
  if (!rod?.span) return null;
  const [first, end] = rod.span.map((text) => Date.parse(text));
  return [days === null ? first : Math.max(first, end - days * DAY), end].map((ms) => new Date(ms).toISOString());
}

async function drawHistory() {
  for (const button of ranges) button.setAttribute("aria-pressed", String(!zoomed && button.dataset.days === String(days)));
  const range = stretch();
  if (!range) return;
  const span = `from=${encodeURIComponent(range[0])}&to=${encodeURIComponent(range[1])}`;
  const [history, chart] = await Promise.all([ask(`${base}/history?${span}&points=1200`), ask(`${base}/chart`)]);
  await figures.relative(relative.plot, rod, history, alarms, range);
  await figures.absolute(absolute.plot, rod, history, range);
  await figures.charts(charts.plot, chart, range);
  charts.element.hidden = ![chart.evidence, chart.evidence_peers, chart.evidence_blind].some((values) => values.some((value) => value !== null));
  await figures.temperature(temperature.plot, history, range);
  temperature.element.hidden = history.temperature_c.every((value) => value === null);
  const each = history.step_s === null ? "each point is one record" : `each point is the mean of ${figures_span(history.step_s)}`;
  const last = history.relative_force_at_reference.mean.findLast((value) => value !== null) ?? history.relative_force.mean.findLast((value) => value !== null);
  relative.words.textContent = "Change of the axial force since the baseline, with its 95 % interval" +
    (last === undefined ? "" : `; the last value shown is ${percent(last)} %`) + `. Green: the baseline; red: an alarm was raised; ${each}.`;
  relative.plot.dataset.points = String(history.time.length);
  for (const { plot } of [relative, absolute, charts, temperature]) {
    plot.removeAllListeners?.("plotly_relayout");
    plot.on("plotly_relayout", (change) => {
      if (change["xaxis.autorange"]) zoomed = null;
      else if (change["xaxis.range[0]"]) zoomed = ["xaxis.range[0]", "xaxis.range[1]"].map((key) => new Date(`${String(change[key]).replace(" ", "T")}Z`).toISOString());
      else return;
      drawHistory();
    });
  }
}

const figures_span = (seconds) => seconds >= 86400 ? `${fixed(seconds / 86400, 0)} d` : seconds >= 3600 ? `${fixed(seconds / 3600, 1)} h` : `${fixed(seconds, 0)} s`;

async function drawLatest(isNew = false) {
  if (isNew) {
    latest = await ask(`${base}/latest`);
    const quantities = latest.latest?.densities.map((d) => d.quantity) ?? [];
    const kept = choice.value;
    choice.replaceChildren(...quantities.map((key) => el("option", { value: key }, figures.quantity(key)[0])));
    if (quantities.includes(kept)) choice.value = kept;
  }
  await drawRefused();
  const look = latest?.latest;
  const here = [waveform, spectrum, density];
  for (const { element } of here) element.hidden = !look;
  latestTitle.textContent = look ? `Latest record: ${time(look.start)} UTC, ${fixed(look.duration_s, 0)} s at ${fixed(look.fs_hz, 0)} Hz` : "No record identified yet";
  latestWords.textContent = look ? motionAndLabels(look) : "";
  if (!look) return;
  waveform.element.hidden = !look.waveform;
  if (look.waveform) await figures.waveform(waveform.plot, look.waveform, latest.unit);
  await figures.spectrum(spectrum.plot, look);
  const modes = look.peaks.filter((peak) => peak.order !== null).map((peak) => `${peak.order}: ${peak.frequency_hz.toFixed(3)} Hz`);
  spectrum.words.textContent = `Power spectral density of the latest identified record. Modes: ${modes.join(", ")}.`;
  const chosen = look.densities.find((d) => d.quantity === choice.value) ?? look.densities[0];
  if (chosen) {
    await figures.density(density.plot, chosen);
    const [title, factor] = figures.quantity(chosen.quantity);
    const said = ([mean, sd]) => {
      const digits = Math.min(Math.max(1 - Math.floor(Math.log10(sd * factor)), 0), 6);
      return `${fixed(mean * factor, digits)} \u00b1 ${fixed(sd * factor, digits)}`;
    };
    density.words.textContent = `Posterior against prior: ${title}, prior ${said(chosen.prior_mean_sd)}, posterior ${said(chosen.posterior_mean_sd)} (mean \u00b1 standard deviation).`;
  }
  drawSources(look.hangs_on);
}

function drawSources(sources) {
  hangsOn.hidden = !sources;
  if (!sources) return;
  const share = (value) => el("td", { class: "n" }, `${fixed(100 * value, 0)} %`);
  hangsOn.replaceChildren(
    table("What the force hangs on: shares of its variance.", [["source"], ["share", "n"], ["less variance if known", "n"]],
      sources.sources.map((part) => el("tr", {}, el("td", {}, part.source), share(part.share), share(part.if_known)))),
    ...sources.said.map((sentence) => el("p", {}, `${sentence}.`)));
}

const MOTION = { ambient: "ambient vibration", "free-decay": "a free decay", "free-decays": "several free decays", blow: "ambient vibration with blows" };

// `a free decay from 2.31 s`
function motionSaid(motion) {
  const onsets = motion.onsets_s.slice(0, 4).map((s) => s.toFixed(2)).join(", ");
  const more = motion.onsets_s.length > 4 ? ` and ${motion.onsets_s.length - 4} more` : "";
  return `${MOTION[motion.kind] ?? motion.kind}${onsets ? ` ${motion.kind === "blow" ? "at" : "from"} ${onsets} s${more}` : ""}`;
}

// A probability in percent, never rounded to certainty.
function share(probability) {
  const percent = 100 * probability;
  if (percent > 99.9 && probability < 1) return "over 99.9 %";
  if (percent < 0.1 && probability > 0) return "under 0.1 %";
  return `${fixed(percent, percent >= 1 && percent <= 99 ? 0 : 1)} %`;
}

function motionAndLabels(look) {
  const motion = look.excitation ? `The record shows ${motionSaid(look.excitation)}. ` : "";
  const labels = look.label_probability === undefined ? "" : `The orders of its modes are right with a probability of ${share(look.label_probability)}.`;
  return motion + labels;
}

// Assignments of peaks to modes that were weighed, each with the force it would give.
function candidateTable(candidates) {
  const cell = (name, kind, ...children) => el("td", { "data-name": name, class: kind }, ...children);
  const rows = candidates.slice(0, 6).map((candidate) => {
    const force = candidate.axial_force_n;
    return el("tr", {},
      cell("modes", "", candidate.modes.map((mode) => `${mode.order} at ${mode.frequency_hz.toFixed(3)} Hz`).join(", ") || "no peak is a mode of the rod"),
      cell("probability", "n", share(candidate.probability)),
      cell("force [kN]", "n", ...(force ? [kilonewtons(force.q50), el("small", {}, `${kilonewtons(force.q025)} to ${kilonewtons(force.q975)}`)] : ["-"])));
  });
  return table("What the peaks may be, the likeliest first, each with the force it would give.", [["modes"], ["probability", "n"], ["force [kN]", "n"]], rows);
}

function peakTable(peaks) {
  const cell = (name, kind, ...children) => el("td", { "data-name": name, class: kind }, ...children);
  const known = peaks.filter((peak) => peak.sd_hz !== undefined);
  const row = (peak) => {
    const digits = Math.min(Math.max(1 - Math.floor(Math.log10(peak.sd_hz || 1e-3)), 1), 6);
    const multiple = peak.multiple_of ? `, ${peak.multiple_of.times} \u00d7 ${peak.multiple_of.frequency_hz.toFixed(3)}` : "";
    return el("tr", {},
      cell("frequency [Hz]", "n", peak.frequency_hz.toFixed(digits), el("small", {}, `\u00b1 ${peak.sd_hz.toFixed(digits)}`)),
      cell("damping [%]", "n", fixed(100 * peak.damping, 3)),
      cell("level [dB]", "n", fixed(peak.level_db, 1)),
      cell("taken for", "", `${peak.taken_for}${multiple}`));
  };
  return known.length ? table("Every peak found; the level is its height over the noise floor.", [["frequency [Hz]", "n"], ["damping [%]", "n"], ["level [dB]", "n"], ["taken for"]], known.map(row)) : "";
}

// The latest rejected record: why it was, and what can be seen of it.
async function drawRefused() {
  const look = latest?.refused;
  for (const element of [refusedTitle, refusedWords, refusedPeaks]) element.hidden = !look;
  const hasSpectrum = Boolean(look?.curve.level_db.length);
  refusedSpectrum.element.hidden = !hasSpectrum;
  refusedWaveform.element.hidden = !look?.waveform;
  if (!look) return;
  refusedTitle.textContent = `Latest rejected record: ${time(look.start)} UTC, ${fixed(look.duration_s, 0)} s at ${fixed(look.fs_hz, 0)} Hz`;
  refusedWords.replaceChildren(el("p", { class: "note" }, el("strong", {}, `${look.rejection.code}: `), look.rejection.message),
    el("p", {}, look.excitation ? `The record shows ${motionSaid(look.excitation)}.` : ""), ...(look.candidates ? [candidateTable(look.candidates)] : []));
  if (look.waveform) await figures.waveform(refusedWaveform.plot, look.waveform, latest.unit);
  if (hasSpectrum) {
    await figures.spectrum(refusedSpectrum.plot, look);
    const peaks = look.peaks.map((peak) => `${peak.frequency_hz.toFixed(3)}${peak.taken_for ? ` (${peak.taken_for})` : ""}`);
    refusedSpectrum.words.textContent = `Power spectral density of the latest rejected record. Peaks [Hz]: ${peaks.join(", ") || "none"}.`;
  }
  refusedPeaks.replaceChildren(peakTable(look.peaks));
}

function recordRow(record) {
  const cell = (name, kind, ...children) => el("td", { "data-name": name, class: kind }, ...children);
  const motion = record.excitation ? ` (${record.excitation.kind.replace("-", " ")})` : "";
  const doubt = record.label_probability != null && record.label_probability < 0.99 ? `; orders right with ${share(record.label_probability)}` : "";
  const said = record.rejection ? `rejected: ${record.rejection.message}` : record.set_aside ? `set aside: ${record.set_aside}` : record.state;
  return el("tr", { "data-start": record.start },
    cell("start", "nowrap", time(record.start)),
    cell("length [s]", "n", record.duration_s === null ? "-" : fixed(record.duration_s, 0)),
    cell("frequencies [Hz]", "", (record.modes ?? []).map((mode) => mode.frequency_hz.toFixed(3)).join(", ") || "-"),
    cell("force [kN]", "n", ...interval(record.axial_force_n, kilonewtons)),
    cell("change [%]", "n", ...interval(record.relative_force_at_reference ?? record.relative_force, (r) => percent(r))),
    cell("temperature [\u00b0C]", "n", record.temperature_c === null || record.temperature_c === undefined ? "-" : fixed(record.temperature_c, 1)),
    cell("result", "", `${said}${motion}${doubt}`));
}

async function drawRecords(isOlder = false) {
  const before = isOlder && next ? `&before=${encodeURIComponent(next)}` : "";
  const answer = await ask(`${base}/records?limit=25&rejected=${rejectedOnly.checked}${before}`);
  shown = isOlder ? shown.concat(answer.records) : answer.records;
  next = answer.next;
  older.hidden = !next;
  records.replaceChildren(shown.length
    ? table("The latest first; times are UTC. The force is that of each record alone.", [["start"], ["length [s]", "n"], ["frequencies [Hz]"], ["force [kN]", "n"], ["change [%]", "n"], ["T [\u00b0C]", "n"], ["result"]], shown.map(recordRow))
    : el("p", {}, answer.older_lines_removed ? "" : rejectedOnly.checked ? "None was rejected." : "There are no records."));
  if (answer.older_lines_removed) {
    records.append(el("p", { class: "note calm" }, "Older records are no longer listed one by one ([store] keep_lines_d); tirante history --format csv has their numbers."));
  }
}

function drawFacts() {
  const fact = (name, ...children) => el("div", {}, el("dt", {}, name), el("dd", {}, ...children));
  const mark = rod.compensated || !rod.relative_force ? "" : "~";
  const share = rod.records ? 100 * rod.rejected / rod.records : 0;
  const segment = rod.segments.at(-1);
  notes.replaceChildren(...rod.alarms.map((alarm) => alarmNote(alarm)),
    ...doubts(rod).map((doubt) => el("p", { class: "note" }, doubt)),
    ...rod.waiting.map((request) => el("p", { class: "note calm" }, `asked for, waits for the next record: ${request}`)));
  facts.replaceChildren(
    ...(isAlone(rod) ? [fact("axial force [kN]", ...force(rod, kilonewtons), el("small", {}, "of the latest record alone"))] : []),
    fact("state", state(rod), el("small", {}, why(rod) ?? (rod.since ? `since ${time(rod.since)}` : ""))),
    fact("change since the baseline [%]", mark, ...interval(rod.relative_force, (r) => percent(r))),
    ...(isAlone(rod) ? [] : [fact("force given the baseline [kN]", ...force(rod, kilonewtons))]),
    fact("last record", time(rod.latest_record), el("small", {}, `${fixed(rod.records, 0)} records, ${fixed(share, 1)} % rejected`)),
    fact("baseline", segment?.baseline ? time(segment.baseline[0]) : "-", el("small", {}, segment
      ? `segment ${segment.number} (${segment.reason})${segment.baseline ? `, ${segment.baseline_records} records` : ""}${segment.fault ? `; ${segment.fault}` : ""}` : "")),
    fact("temperature", rod.thermal ? `${fixed(rod.thermal.slope_per_k * 100, 3)} % per K` : "-", el("small", {}, rod.thermal
      ? `\u00b1 ${fixed(rod.thermal.slope_sd_per_k * 100, 3)}${rod.reference_temperature_c === null ? "" : `, reference ${fixed(rod.reference_temperature_c, 1)} \u00b0C`}` : "not compensated")));
}

async function draw() {
  const [answer, page] = await Promise.all([ask(base), ask(`/api/v1/alarms?rod=${encodeURIComponent(id)}&limit=100`)]);
  rod = answer;
  alarms = page.alarms;
  content.querySelector(".failed")?.remove();
  drawFacts();
  await Promise.all([drawHistory(), drawLatest(true), shown.length <= 25 ? drawRecords() : null]);
}

show(content, notes, facts,
  el("div", { class: "tools", role: "group", "aria-label": "Stretch of time shown" }, ranges),
  el("h2", {}, "Relative force"), relative.element, charts.element,
  el("h2", {}, "Absolute force"), absolute.element, temperature.element,
  latestTitle, el("div", { class: "pair" }, waveform.element, spectrum.element),
  el("div", { class: "tools" }, el("label", { for: "quantity" }, "Quantity "), choice), density.element, hangsOn,
  latestTitle, latestWords, el("div", { class: "pair" }, waveform.element, spectrum.element),
  el("div", { class: "tools" }, el("label", { for: "quantity" }, "Quantity "), choice), density.element,
  refusedTitle, refusedWords, el("div", { class: "pair" }, refusedWaveform.element, refusedSpectrum.element), refusedPeaks,
  el("h2", {}, "Records"), el("div", { class: "tools" }, rejectedOnly, el("label", { for: "rejected" }, "rejected ones only")), records, older);
live(draw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => draw());
