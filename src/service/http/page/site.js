// The overview: one row per rod.

import { age, ahead, alarmNote, ask, degrees, el, fixed, force, grouped, interval, isAlone, kilonewtons, live, newest, next, percent, rodLink, show, state, table, time, why } from "./common.js";

const content = document.getElementById("content");

function spark(trend) {
  const points = trend.time.map((text, i) => [Date.parse(text), trend.mean[i]]).filter(([, mean]) => mean !== null);
  if (points.length < 2) return "";
  const xs = points.map(([x]) => x), ys = points.map(([, y]) => y);
  const low = Math.min(...ys, 1), high = Math.max(...ys, 1), span = Math.max(high - low, 1e-4);
  const x = (t) => 1 + 118 * (t - xs[0]) / (xs.at(-1) - xs[0]);
  const y = (v) => 29 - 26 * (v - low) / span;
  const space = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(space, "svg");
  svg.setAttribute("viewBox", "0 0 120 32");
  svg.setAttribute("class", "spark");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", `change over the last ${points.length} days shown: from ${percent(ys[0])} % to ${percent(ys.at(-1))} %`);
  const zero = document.createElementNS(space, "line");
  for (const [key, value] of Object.entries({ x1: 0, x2: 120, y1: y(1), y2: y(1) })) zero.setAttribute(key, value);
  const path = document.createElementNS(space, "path");
  path.setAttribute("d", points.map(([t, v], i) => `${i ? "L" : "M"}${x(t).toFixed(1)} ${y(v).toFixed(1)}`).join(""));
  svg.append(zero, path);
  return svg;
}

function row(rod) {
  const mark = rod.compensated || !rod.relative_force ? "" : "~";
  const share = rod.recent.records ? 100 * rod.recent.rejected / rod.recent.records : 0;
  const cell = (name, kind, ...children) => el("td", { "data-name": name, class: kind }, ...children);
  const small = (words) => el("small", {}, words);
  const celsius = rod.compensated ? rod.reference_temperature_c : rod.temperature_c;
  const hasForce = rod.force_n || rod.axial_force_n;
  return el("tr", { "data-rod": rod.rod },
    el("th", { scope: "row" }, el("a", { href: rodLink(rod.rod) }, rod.rod)),
    cell("state", "", state(rod), small(why(rod) ?? (rod.since ? `since ${time(rod.since)}` : ""))),
    cell("force [kN]", "n", ...force(rod, kilonewtons), hasForce ? small(celsius === null ? "temperature not measured" : `at ${degrees(celsius)}`) : null,
      isAlone(rod) ? el("small", { class: "words" }, "of one record alone") : null),
    cell("change [%]", "n", mark, ...interval(rod.relative_force, (r) => percent(r))),
    cell("last year", "", spark(rod.trend)),
    cell("last record", "nowrap", time(rod.latest_record), small(age(rod.latest_record, rod.stale_after_s)), ahead(rod)),
    cell(`last ${rod.recent.days} d of data`, "n", counted(rod.recent.records, "record"), small(`${fixed(share, 1)} % rejected`), small(`${fixed(rod.records, 0)} in all`)));
}

const counted = (count, noun) => `${fixed(count, 0)} ${noun}${count === 1 ? "" : "s"}`;
let site = null;

// The daemon's lasting conditions; the one that stopped the monitoring is told above them.
function lasting(monitoring) {
  if (!monitoring) return [];
  const note = (strong, words, since) => el("div", { class: "note" }, el("strong", {}, strong), words, el("div", { class: "about" }, `since ${time(since)} UTC`));
  return monitoring.conditions.filter((one) => !one.is_told)
    .map((one) => note(`${one.kind}: `, [one.about, one.detail].filter(Boolean).join(", "), one.since));
}

// Next conditions that rods wait for, each with its rods.
function coming() {
  const waiting = grouped(site.rods, next);
  return [...waiting].filter(([words]) => words).map(([words, rods]) => el("p", { class: "about" }, `${rods.map((rod) => rod.rod).join(", ")}: ${words}`));
}

async function draw() {
  site = await ask("api/v1/site");
  document.getElementById("title").textContent = site.site;
  document.title = `${site.site} - Tirante`;
  document.getElementById("brand").title = `version ${site.version}`;
  const alarms = site.rods.flatMap((rod) => rod.alarms.map((alarm) => ({ rod: rod.rod, alarm })));
  const open = alarms.filter(({ alarm }) => !alarm.acknowledged).length;
  const uncompensated = site.rods.some((rod) => rod.relative_force && !rod.compensated);
  show(content,
    site.monitoring?.stopped_since ? el("div", { class: "note", id: "stopped" }, el("strong", {}, `monitoring stopped since ${time(site.monitoring.stopped_since)} UTC: `),
      [site.monitoring.conditions.find((one) => one.is_told)?.about, site.monitoring.why].filter(Boolean).join(", ")) : "",
    el("p", { class: "about", id: "summary" },
      `${counted(site.rods.length, "rod")}, ` +
      (alarms.length ? `${counted(alarms.length, "alarm")} standing, ${open} not acknowledged` : "no alarm stands")),
    lasting(site.monitoring),
    alarms.map(({ rod, alarm }) => {
      const note = alarmNote(alarm);
      note.prepend(el("a", { href: rodLink(rod) }, rod), " ");
      return note;
    }),
    site.rods.length
      ? table("Force with its 95 % interval at the temperature beneath it, and its change since the rod's baseline. Times are UTC.",
        [["rod"], ["state"], ["force [kN]", "n"], ["change [%]", "n"], ["last year"], ["last record"], [`last ${site.rods[0].recent.days} d of data`, "n"]], site.rods.map(row))
      : el("p", { class: "note calm", id: "next" }, "No record has come yet. Next: ", el("code", {}, "tirante replay --config site.toml --store site.db FILES"),
        ", or data to a running ", el("code", {}, "tirante run"), ". Rods appear here by themselves."),
    coming(),
    uncompensated ? el("p", { class: "about" }, "~ not compensated: at the temperature of the latest record.") : "");
  const [latest] = site.rods.filter((rod) => rod.latest_record).sort((a, b) => Date.parse(b.latest_record) - Date.parse(a.latest_record));
  newest(latest?.latest_record ?? null, latest?.stale_after_s ?? null);
}

live(draw);
