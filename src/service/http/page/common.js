// Functions shared by every document of the page: requests, elements, formatted numbers, the live stream.

import { siteAtCentre } from "./place.js";

export async function ask(path, options) {
  const { response, text } = await fetch(path, { headers: { accept: "application/json" }, ...options })
    .then(async (response) => ({ response, text: await response.text() }))
    .catch((error) => { throw Object.assign(new Error(error.message), { isUnanswered: true }); });
  let body = null;
  try { body = JSON.parse(text); } catch { /* an answer that is no JSON is shown as it is */ }
  if (!response.ok) {
    const error = new Error(body?.error ?? `${response.status}: ${text.slice(0, 200)}`);
    error.status = response.status;
    error.retryAfterS = Number(response.headers.get("retry-after")) || null;
    throw error;
  }
  return body;
}

// An element; text goes in as text, never as markup.
export function el(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === false || value === null || value === undefined) continue;
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else element.setAttribute(key, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

export function table(caption, heads, rows) {
  const head = heads.map(([name, kind]) => el("th", { scope: "col", class: kind }, name));
  return el("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption },
    el("table", { class: "cards" }, el("caption", {}, caption), el("thead", {}, el("tr", {}, head)), el("tbody", {}, rows)));
}

const number = (digits) => new Intl.NumberFormat("en", { minimumFractionDigits: digits, maximumFractionDigits: digits });
export const fixed = (value, digits) => number(digits).format(value);
export const kilonewtons = (newtons) => fixed(newtons / 1e3, Math.abs(newtons) < 1e5 ? 1 : 0);
export const percent = (ratio, digits = 2) => {
  const value = (ratio - 1) * 100;
  return (value > 0 ? "+" : "") + fixed(value, digits);
};

// Day of a time rounded to the minute: onsets are whole days, and rounding must not move them to the day before.
export const day = (text) => new Date(Date.parse(text) + 30_000).toISOString().slice(0, 10);
export const time = (text) => text ? text.slice(0, 16).replace("T", " ") : "-";

export const degrees = (celsius) => `${fixed(celsius, 1)} \u00b0C`;

// A probability in percent, never rounded to certainty.
export function share(probability) {
  const percent = 100 * probability;
  if (percent > 99.9) return "over 99.9 %";
  if (percent < 0.1) return "under 0.1 %";
  return `${fixed(percent, percent >= 1 && percent <= 99 ? 0 : 1)} %`;
}

function ago(s) {
  if (s < -60) return "ahead of this clock";
  for (const [length, name] of [[86400, "d"], [3600, "h"], [60, "min"]]) {
    if (s >= 2 * length) return `${Math.floor(s / length)} ${name} ago`;
  }
  return `${Math.max(Math.floor(s), 0)} s ago`;
}

// Items by a key, in the order of their first ones. (Map.groupBy is missing in browsers before 2024.)
export function grouped(items, key) {
  const groups = new Map();
  for (const item of items) {
    const group = groups.get(key(item));
    if (group) group.push(item); else groups.set(key(item), [item]);
  }
  return groups;
}

// Age of the data, updated as time passes; data ahead of this clock say nothing of how old they are, and are never fresh.
export function age(text, stale_s) {
  const element = el("span", { class: "age" });
  const tell = () => {
    const s = (Date.now() - Date.parse(text)) / 1e3;
    element.textContent = text ? ago(s) : "never";
    element.className = `age ${text && s >= -60 && (stale_s === null || s <= stale_s) ? "fresh" : "stale"}`;
  };
  element.addEventListener("tick", tell);
  tell();
  return element;
}
setInterval(() => document.querySelectorAll(".age, .state").forEach((element) => element.dispatchEvent(new Event("tick"))), 5_000);

// Shows the age of the latest data in the head of the page, separate from the state of the connection.
export function newest(text, stale_s) {
  document.getElementById("newest").replaceChildren("latest record ", age(text, stale_s));
}

// 602 (590 to 615)
export const interval = (values, show) =>
  values ? [show(values.mean), el("small", {}, `${show(values.q025)} to ${show(values.q975)}`)] : ["-"];

// Force shown for a rod, with its marks: given the baseline, else that of the latest record alone. A baseline does not mend a doubt.
const DOUBTS = {
  conflict: "model and data disagree: the force may be wrong by more than its interval says",
  prior: "hardly any rod of the prior has these frequencies: check length, section, material and expected force",
  orders: "the orders of the modes are not certain: other orders give another force",
  wide: "the interval spans more than a factor of ten: the record hardly tells the force; see what it hangs on",
};
export const isAlone = (status) => !status.force_n && Boolean(status.axial_force_n);
export const doubts = (status) => (status.force_n || status.axial_force_n ? status.doubts.map((doubt) => DOUBTS[doubt] ?? doubt) : []);
export function force(status, show) {
  const mark = doubts(status).length === 0 ? "" : status.doubts.some((doubt) => doubt === "conflict" || doubt === "prior") ? "! " : "? ";
  if (isAlone(status)) return [mark, ...interval(status.axial_force_n, show)];
  return [mark + (status.compensated || !status.relative_force ? "" : "~"), ...interval(status.force_n, show)];
}

// At a centre the documents of a site are in sites/SITE/ below the list of all sites, wherever a proxy puts that.
if (siteAtCentre) document.querySelector("nav")?.prepend(el("a", { href: "../../" }, "Sites"));

export const rodLink = (rod) => `rod?id=${encodeURIComponent(rod)}`;

// Records that a wrong clock dated after the latest one.
export const ahead = (status) => (status.records_ahead ? el("small", {}, `${fixed(status.records_ahead, 0)} dated after that by a wrong clock`) : null);

// State of a rod, updated as time passes: a rod whose data are stale is not followed, whatever state its last record left.
export function state(status) {
  const element = el("span", {});
  const tell = () => {
    const s = (Date.now() - Date.parse(status.latest_record)) / 1e3;
    const isStale = ["monitoring", "learning"].includes(status.state) && status.latest_record && status.stale_after_s !== null && s > status.stale_after_s;
    element.textContent = isStale ? `no new data (${status.state})` : status.state.replace("-", " ");
    element.className = `state ${isStale ? "stale" : status.state}`;
  };
  element.addEventListener("tick", tell);
  tell();
  return element;
}

export function why(status) {
  if (status.never_seen_since && !status.state_reason) return `never seen since ${time(status.never_seen_since)}`;
  if (status.baseline_records !== null) {
    const goals = status.learning_takes;
    return `baseline ${status.baseline_records}${goals ? ` of ${goals.records}` : ""} records, charts ${status.learned_periods}${goals ? ` of ${goals.periods}` : ""} periods`;
  }
  return status.state_reason;
}

// Next condition that a rod waits for before it is followed.
export function next(status) {
  if (status.records === 0) return "no record has come yet; next, look whether its channel sends under the topic of the configuration; its first record shows the force.";
  const goals = status.learning_takes;
  if (!goals) return null;
  const counted = (count, noun) => `${count} more ${noun}${count === 1 ? "" : "s"}`;
  const records = Math.max(goals.records - status.baseline_records, 0), periods = Math.max(goals.periods - status.learned_periods, 0);
  return records > 0
    ? `next, ${counted(records, "record")} for the baseline. Until then each record gives a force of its own; changes of force are followed from the baseline on.`
    : `next, ${counted(periods, "period")} that teach what temperature does. From then on a drift raises an alarm.`;
}

export function alarmNote(alarm, link = true) {
  const known = alarm.acknowledged ? `, acknowledged ${time(alarm.acknowledged)}` : "";
  const over = alarm.cleared ? `, its condition ended ${time(alarm.cleared)}` : "";
  return el("div", { class: alarm.acknowledged ? "note calm" : "note" },
    el("strong", {}, `${alarm.kind}: `), alarm.message,
    el("div", { class: "about" }, `since ${time(alarm.raised)} UTC${known}${over} `,
      link ? el("a", { href: "alarms" }, "alarms") : null));
}

// Replaces the content. The document hides it until it has been drawn once, so that nothing moves.
export function show(content, ...children) {
  content.replaceChildren(...children.flat());
}

// Shows the reason for a missing answer above the present content; content that was never drawn stays hidden.
function failed(content, error) {
  const words = error.status ? error.message.charAt(0).toUpperCase() + error.message.slice(1)
    : error.isUnanswered ? `The server did not answer: ${error.message}`
    : `This page broke: ${error.message}. Please report this, with the name and version of your browser; tirante status and tirante report say the same as the page.`;
  document.querySelector(".failed")?.remove();
  content.before(el("p", { class: "note failed", role: "alert" }, words));
  content.hidden = content.getAttribute("aria-busy") === "true";
}

// Runs what was asked for on the page; if it fails, the reason is shown.
export async function attempt(content, work) {
  try {
    await work();
    document.querySelector(".failed")?.remove();
  } catch (error) {
    failed(content, error);
  }
}

// Calls `draw` when the server's stream of commits opens and after each of them, one call at a time; a burst ends in one call. Returns
// the function that draws anew in the same way.
export function live(draw) {
  const light = document.getElementById("live"), content = document.getElementById("content");
  let isDrawing = false, isAsked = false, isBegun = false;
  const redraw = async () => {
    isBegun = true;
    if (isDrawing) { isAsked = true; return; }
    isDrawing = true;
    do {
      isAsked = false;
      try {
        content.hidden = false;
        await draw();
        document.querySelector(".failed")?.remove();
        content.setAttribute("aria-busy", "false");
      } catch (error) {
        failed(content, error);
        if (error.retryAfterS) setTimeout(redraw, 1000 * error.retryAfterS);
      }
    } while (isAsked);
    isDrawing = false;
  };
  const connect = () => {
    const stream = new EventSource("api/v1/events");
    stream.addEventListener("commit", () => {
      light.className = "on";
      light.textContent = "connected";
      redraw();
    });
    stream.onerror = () => {
      light.className = "off";
      light.textContent = "not connected, trying again";
      if (!isBegun) redraw();
      // After a server refuses the stream, the browser does not try again by itself.
      if (stream.readyState === EventSource.CLOSED) setTimeout(connect, 10_000);
    };
  };
  connect();
  setTimeout(() => { if (!isBegun) redraw(); }, 700);
  return redraw;
}
