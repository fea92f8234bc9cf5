// One rod: state, forces over time, events, records.

import { age, ahead, alarmNote, ask, attempt, day, degrees, doubts, el, fixed, force, interval, isAlone, kilonewtons, live, newest, next, percent, share, show, state, table, time, why } from "./common.js";
import * as figures from "./figures.js";
import * as latest from "./latest.js";
import { Plot } from "./plot.js";

const id = new URLSearchParams(location.search).get("id") ?? "";
const base = `api/v1/rods/${encodeURIComponent(id)}`;
const content = document.getElementById("content");
document.getElementById("title").textContent = id;
document.title = `${id} - Tirante`;

Plot.owner = id;
const notes = el("div", {}), facts = el("dl", { class: "facts" });
const relative = new Plot("relative", ""), charts = new Plot("charts",
  "Evidence of a change of force over its limit: an alarm is raised where the line crosses 1; beyond 1000 it is drawn at 1000. The other lines stand in where there is no temperature.", true);
const absolute = new Plot("absolute", "");
const thermal = new Plot("thermal", "");
const frequencies = new Plot("frequencies", "");
const temperature = new Plot("temperature", "Temperature of the records.", true);
const events = el("details", { id: "events" });
const records = el("div", {}), older = el("button", { type: "button", hidden: true, onclick: () => attempt(content, () => drawRecords(true)) }, "older ones");
const rejectedOnly = el("input", { type: "checkbox", id: "rejected", onchange: () => attempt(content, () => drawRecords()) });
const nothing = el("p", { class: "note calm", id: "nothing", hidden: true });

// Time range shown: a number of last days, everything (null), or the zoomed range. It is kept in the address.
const DAY = 86_400_000, FIRST = Date.UTC(1970), LAST = Date.UTC(2200);
let days = 365, zoomed = null, rod = null, alarms = [], look = null, shown = [], following = null;

function recall() {
  const kept = new URLSearchParams(location.hash.slice(1));
  const range = ["from", "to"].map((key) => Date.parse(kept.get(key)));
  zoomed = range.every(Number.isFinite) && range[0] < range[1] ? within(range, FIRST, LAST) : null;
  days = kept.get("days") === "all" ? null : Number(kept.get("days")) || 365;
}

// A range moved, and shortened if it is longer than there is room, to lie between two times; at least a second long.
function within([from, to], first, last) {
  const length = Math.min(Math.max(to - from, 1000), last - first);
  const begin = Math.min(Math.max((from + to - length) / 2, first), last - length);
  return [Math.round(begin), Math.round(begin + length)];
}

// Shows the last days, or a range: at most as far from the records on either side as they are long.
function go(length, range) {
  [days, zoomed] = [length, range];
  if (zoomed && rod?.span) {
    const [first, end] = rod.span.map((text) => Date.parse(text));
    zoomed = within(zoomed, Math.max(2 * first - end, FIRST), Math.min(2 * end - first, LAST));
  }
  const iso = (ms) => new Date(ms).toISOString();
  history.pushState(null, "", `#${zoomed ? `from=${iso(zoomed[0])}&to=${iso(zoomed[1])}` : `days=${days ?? "all"}`}`);
  attempt(content, drawHistory);
}

function stretch() {
  if (zoomed) return zoomed;
  if (!rod?.span) return null;
  const [first, end] = rod.span.map((text) => Date.parse(text));
  return [days === null ? first : Math.max(first, end - days * DAY), end];
}

const ranges = [["7 d", 7], ["30 d", 30], ["1 y", 365], ["all", null]].map(([name, length]) =>
  el("button", { type: "button", "data-days": String(length), onclick: () => go(length, null) }, name));
const moves = [["\u2190", "earlier", 0.5, 1], ["\u2192", "later", -0.5, 1], ["+", "closer", 0, 0.5], ["\u2212", "wider", 0, 2]].map(([sign, name, shift, factor]) =>
  el("button", { type: "button", "aria-label": name, title: name, onclick: () => {
    const range = stretch();
    if (!range) return;
    const length = range[1] - range[0], middle = (range[0] + range[1]) / 2 - shift * length;
    go(days, [middle - (factor * length) / 2, middle + (factor * length) / 2]);
  } }, sign));

const tools = el("div", { class: "tools", role: "group", "aria-label": "Stretch of time shown" }, ranges, moves);
const length_of = (seconds) => seconds >= 86400 ? `${fixed(seconds / 86400, 0)} d` : seconds >= 3600 ? `${fixed(seconds / 3600, 1)} h` : `${fixed(seconds, 0)} s`;

let turn = 0;

async function drawHistory() {
  const mine = (turn += 1);
  tools.hidden = !rod?.span;
  for (const button of ranges) button.setAttribute("aria-pressed", String(!zoomed && button.dataset.days === String(days)));
  const range = stretch();
  nothing.hidden = true;
  if (!range) {
    for (const { element } of [relative, absolute, charts, thermal, frequencies, temperature]) element.hidden = true;
    for (const [heading] of headings) heading.hidden = true;
    return;
  }
  const [from, to] = range.map((ms) => encodeURIComponent(new Date(ms).toISOString()));
  const [history, chart, modes] = await Promise.all([
    ask(`${base}/history?from=${from}&to=${to}&points=1200`), ask(`${base}/chart`), ask(`${base}/frequencies?from=${from}&to=${to}&points=600`)]);
  // A later call has taken over.
  if (mine !== turn) return;
  nothing.hidden = history.time.length > 0;
  nothing.textContent = `No record lies between ${range.map((ms) => time(new Date(ms).toISOString())).join(" and ")} UTC.`;
  const axis = { isTime: true, range, zoom: (range) => go(days, range) };
  const each = history.step_s === null ? "each point is one record" : `each point is the mean of ${length_of(history.step_s)}`;
  const reference = history.relative_force_at_reference.mean.findLast((value) => value !== null);
  const last = reference ?? history.relative_force.mean.findLast((value) => value !== null);
  const onset = alarms.find((alarm) => alarm.stands && alarm.change)?.change;
  relative.words.textContent = "Change of the axial force since the baseline, with its 95 % interval" +
    (last === undefined ? "" : `; the last value shown is ${percent(last)} % ${reference === undefined ? "at its own temperature" : figures.atReference(rod)}`) +
    `. Green: the baseline; triangles and red lines: alarms.` +
    (onset ? ` Red stretch: the change began between ${day(onset.onset_q025)} and ${day(onset.onset_q975)} (95 %).` : "") + ` At a gap the line stops; ${each}.`;
  absolute.words.textContent = "Axial force with its 95 % interval. A record alone knows little of the rod; given the baseline its force is sharper. Two temperatures give two forces of one record." +
    doubts(rod).map((doubt) => ` Of the latest record: ${doubt}.`).join("");
  thermal.words.textContent = rod.thermal ? `Force of each record at its own temperature, with the line that was learned: ${fixed(100 * rod.thermal.slope_per_k, 3)} \u00b1 ${fixed(196 * rod.thermal.slope_sd_per_k, 3)} % per K (95 %), for a temperature that stays. Days of quick warming lie off it.` : "";
  frequencies.words.textContent = "Natural frequencies, each about its median, with their 95 % intervals" +
    (modes.every > 1 ? `; one record in ${modes.every} is drawn.` : "; every record is drawn.") + " Saved as CSV they are in Hz.";
  // Plots not drawn are hidden. A plot is measured while it is drawn, so it must be visible first. Between two of them the browser may
  // answer the person who reads.
  const figure = async (plot, isThere, draw) => {
    plot.element.hidden = !isThere;
    if (!isThere) return;
    draw();
    await new Promise((resolve) => setTimeout(resolve));
  };
  const some = (values, least = 1) => values.filter((value) => value !== null).length >= least;
  await figure(relative, some(history.relative_force.mean), () => figures.relative(relative, rod, history, alarms, axis));
  await figure(charts, [chart.evidence, chart.evidence_peers, chart.evidence_blind].some((values) => some(values)), () => figures.charts(charts, chart, axis));
  await figure(absolute, some(history.axial_force_n.mean), () => figures.absolute(absolute, rod, history, axis));
  await figure(frequencies, modes.modes.some((mode) => some(mode.frequency_hz, 2)), () => figures.frequencies(frequencies, modes, axis));
  await figure(temperature, some(history.temperature_c, 2), () => figures.temperature(temperature, history, axis));
  thermal.element.hidden = false;
  thermal.element.hidden = !figures.thermal(thermal, rod, history, alarms);
  relative.plot.dataset.points = String(history.time.length);
  for (const [heading, plots] of headings) heading.hidden = plots.every((plot) => plot.element.hidden);
}

const headings = [[el("h2", {}, "Relative force"), [relative, charts]], [el("h2", {}, "Absolute force"), [absolute, thermal]],
  [el("h2", {}, "Frequencies and temperature"), [frequencies, temperature]]];

// Marks of a record's forces and their reasons, by the limits of docs/measure.md.
function recordDoubts(record) {
  const isConflict = record.conflict != null && record.conflict >= 3;
  const isPrior = !isConflict && record.prior_tail != null && record.prior_tail <= 0.01;
  const isOrders = record.label_probability != null && record.label_probability < 0.99;
  const { q025: low, q975: high } = record.axial_force_n ?? {};
  const isWide = low * high <= 0 || Math.max(high / low, low / high) > 10;
  return {
    mark: isConflict || isPrior ? "! " : isOrders || isWide ? "? " : "",
    words: [isConflict ? `conflict ${fixed(record.conflict, 1)}` : null, isPrior ? "hardly in the prior" : null,
      isOrders ? `orders right with ${share(record.label_probability)}` : null, isWide ? "wide interval" : null].filter(Boolean),
  };
}

function recordRow(record) {
  const cell = (name, kind, ...children) => el("td", { "data-name": name, class: kind }, ...children);
  const motion = record.excitation ? ` (${record.excitation.kind.replace("-", " ")})` : "";
  const { mark, words } = recordDoubts(record);
  const said = record.rejection ? `rejected: ${record.rejection.message}` : record.set_aside ? `set aside: ${record.set_aside}` : record.state;
  const own = record.temperature_c ?? null, reference = record.reference_temperature_c ?? null;
  const at = (celsius) => el("small", {}, celsius === null ? "temperature not measured" : `at ${degrees(celsius)}`);
  const forceAt = (values, celsius) => (values ? [...interval(values, kilonewtons), at(celsius)] : ["-"]);
  const marked = ([value, ...rest]) => [value === "-" ? value : mark + value, ...rest];
  const isReferred = Boolean(record.force_at_reference_n);
  const changed = record.relative_force_at_reference ?? record.relative_force;
  return el("tr", { "data-start": record.start },
    cell("start", "", el("span", { class: "nowrap" }, time(record.start)), record.file ? el("small", { class: "file" }, `in ${record.file}`) : null),
    cell("length [s]", "n", record.duration_s === null ? "-" : fixed(record.duration_s, 0)),
    cell("frequencies [Hz]", "", (record.modes ?? []).map((mode) => mode.frequency_hz.toFixed(3)).join(", ") || "-"),
    cell("force, record alone [kN]", "n", ...marked(forceAt(record.axial_force_n, own))),
    cell("force given the baseline [kN]", "n", ...marked(forceAt(record.force_at_reference_n ?? record.tracked_force_n, isReferred ? reference : own))),
    cell("change [%]", "n", ...interval(changed, (r) => percent(r)), changed ? at(isReferred ? reference : own) : null),
    cell("result", "", [`${said}${motion}`, ...words].join("; "), ...sensorsOf(record)));
}

// Sensors of a rod with several, the leading one first, and those that were left out with the reason.
function sensorsOf({ sensors }) {
  if (!sensors) return [];
  const used = sensors.used.length ? [`by ${sensors.used.join(", ")}`] : [];
  const out = sensors.left_out.map(({ sensor, why }) => `without ${sensor}${why ? `: ${why}` : ""}`);
  return [...used, ...out].map((text) => el("small", { class: "sensors" }, text));
}

let listTurn = 0, isGrowing = false, listedOnly = false;

async function drawRecords(isOlder = false) {
  const mine = (listTurn += 1);
  const before = isOlder && following ? `&before=${encodeURIComponent(following)}` : "";
  // Older ones go on the list that is shown, whatever is ticked meanwhile.
  const only = isOlder ? listedOnly : rejectedOnly.checked;
  older.disabled = true;
  isGrowing = isOlder;
  let answer;
  try {
    answer = await ask(`${base}/records?limit=25&rejected=${only}${before}`);
  } finally {
    if (mine === listTurn) older.disabled = isGrowing = false;
  }
  // A later call has taken over.
  if (mine !== listTurn) return;
  listedOnly = only;
  shown = isOlder ? shown.concat(answer.records) : answer.records;
  following = answer.next;
  older.hidden = !following;
  records.replaceChildren(shown.length
    ? table("The latest first; times are UTC. Each force says at which temperature it is.", [["start"], ["length [s]", "n"], ["frequencies [Hz]"], ["force, record alone [kN]", "n"], ["force given the baseline [kN]", "n"], ["change [%]", "n"], ["result"]], shown.map(recordRow))
    : el("p", {}, answer.older_lines_removed ? "" : only ? "None was rejected." : "There are no records."));
  if (answer.older_lines_removed) {
    records.append(el("p", { class: "note calm" }, "Older records are no longer listed one by one ([store] keep_lines_d); tirante history --format csv has their numbers."));
  }
}

function drawFacts() {
  const fact = (name, ...children) => el("div", {}, el("dt", {}, name), el("dd", {}, ...children));
  const mark = rod.compensated || !rod.relative_force ? "" : "~";
  const rejected = rod.records ? 100 * rod.rejected / rod.records : 0;
  const segment = rod.segments.find((one) => one.number === rod.segment), record = look.record;
  const own = record?.temperature_c ?? null;
  const at = isAlone(rod) || !rod.compensated ? (own === null ? ", temperature not measured" : ` at ${degrees(own)}`) : ` ${figures.atReference(rod)}`;
  const small = (...words) => el("small", {}, ...words);
  const onset = rod.alarms.find((alarm) => alarm.change)?.change;
  const coming = next(rod);
  notes.replaceChildren(...rod.alarms.map((alarm) => alarmNote(alarm)),
    ...doubts(rod).map((doubt) => el("p", { class: "note" }, doubt)),
    ...(coming ? [el("p", { class: "note calm", id: "next" }, coming.charAt(0).toUpperCase() + coming.slice(1))] : []),
    ...rod.waiting.map((request) => el("p", { class: "note calm" }, `asked for, waits for the next record: ${request}`)));
  facts.replaceChildren(
    fact("state", state(rod), small(why(rod) ?? (rod.since ? `since ${time(rod.since)}` : ""))),
    fact(`axial force${rod.force_n || rod.axial_force_n ? at : ""} [kN]`, ...force(rod, kilonewtons),
      small(isAlone(rod) ? "of the latest record alone" : rod.force_n ? "given the baseline" : "no record has given one yet"),
      rod.compensated && record?.tracked_force_n && own !== null ? small(`the same record at its own ${degrees(own)}: ${kilonewtons(record.tracked_force_n.mean)}`) : null),
    ...(rod.relative_force ? [fact(`change since the baseline${at} [%]`, mark, ...interval(rod.relative_force, (r) => percent(r)))] : []),
    ...(onset ? [fact("onset of the change", day(onset.onset), small(`${day(onset.onset_q025)} to ${day(onset.onset_q975)} (95 %)`))] : []),
    fact("last record", time(rod.latest_record), small(age(rod.latest_record, rod.stale_after_s)), ahead(rod), small(`${fixed(rod.records, 0)} record${rod.records === 1 ? "" : "s"} in all, ${fixed(rejected, 1)} % rejected`)),
    fact("baseline", segment?.baseline ? time(segment.baseline[0]) : "not yet", small(segment
      ? `segment ${segment.number} (${segment.reason})${segment.baseline ? `, ${segment.baseline_records} records` : ""}${segment.fault ? `; ${segment.fault}` : ""}` : "")),
    fact("temperature", rod.thermal ? `${fixed(rod.thermal.slope_per_k * 100, 3)} % per K` : rod.compensated ? `compensated, ${figures.atReference(rod)}` : "not compensated", rod.thermal
      ? small(`\u00b1 ${fixed(196 * rod.thermal.slope_sd_per_k, 3)} (95 %)${rod.reference_temperature_c === null ? "" : `, reference ${degrees(rod.reference_temperature_c)}`}`) : null));
  newest(rod.latest_record, rod.stale_after_s);
}

function drawEvents() {
  const list = figures.events(rod, alarms).reverse();
  const isOpen = events.open;
  events.hidden = list.length === 0;
  events.replaceChildren(el("summary", {}, `Events: ${list.length}`),
    table("What happened to this rod, the latest first. Times are UTC.", [["time"], ["event"], ["details"]], list.map((event) => el("tr", {},
      el("td", { class: "nowrap", "data-name": "time" }, event.text.slice(0, 16)), el("td", { "data-name": "event" }, event.words), el("td", { "data-name": "details" }, event.detail ?? "")))));
  events.open = isOpen;
}

async function draw() {
  // A list that is long already, or grows, is left to whoever reads it.
  const listed = shown.length <= 25 && !isGrowing ? drawRecords() : null;
  // Told below, unless the rod itself has no answer.
  listed?.catch(() => {});
  const [answer, page, single] = await Promise.all([ask(base), ask(`api/v1/alarms?rod=${encodeURIComponent(id)}&limit=100`), ask(`${base}/latest`)]);
  [rod, alarms, look] = [answer, page.alarms, single];
  drawFacts();
  drawEvents();
  latest.draw(look);
  await Promise.all([drawHistory(), listed]);
}

show(content, notes, facts, tools, nothing,
  headings[0][0], relative.element, events, charts.element,
  headings[1][0], absolute.element, thermal.element,
  headings[2][0], frequencies.element, temperature.element,
  ...latest.parts,
  el("h2", {}, "Records"), el("div", { class: "tools" }, rejectedOnly, el("label", { for: "rejected" }, "rejected ones only")), records, older);
recall();
addEventListener("popstate", () => { recall(); attempt(content, drawHistory); });
live(draw);
