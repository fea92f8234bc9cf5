// What every document of the page shares: asking the server, building elements, numbers for people, the live stream.

export async function ask(path, options) {
  const response = await fetch(path, { headers: { accept: "application/json" }, ...options });
  const text = await response.text();
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

export const time = (text) => text ? text.slice(0, 16).replace("T", " ") : "-";

export function ago(text) {
  if (!text) return "";
  const s = (Date.now() - Date.parse(text)) / 1e3;
  if (s < 0) return "ahead of this clock";
  for (const [length, name] of [[86400, "d"], [3600, "h"], [60, "min"]]) {
    if (s >= 2 * length) return `${Math.floor(s / length)} ${name} ago`;
  }
  return `${Math.floor(s)} s ago`;
}

// 602 (590 to 615)
export const interval = (values, show) =>
  values ? [show(values.mean), el("small", {}, `${show(values.q025)} to ${show(values.q975)}`)] : ["-"];

// The force that stands for a rod, with its mark: given the baseline, else that of the latest record alone.
const DOUBTS = {
  conflict: "model and data disagree: the force may be wrong by more than its interval says",
  prior: "hardly any rod of the prior has these frequencies: check length, section, material and expected force",
  orders: "the orders of the modes are not certain: other orders give another force",
};
export const isAlone = (status) => !status.force_n && Boolean(status.axial_force_n);
export const doubts = (status) => (isAlone(status) ? status.doubts.map((doubt) => DOUBTS[doubt] ?? doubt) : []);
export function force(status, show) {
  if (!isAlone(status)) return [status.compensated || !status.relative_force ? "" : "~", ...interval(status.force_n, show)];
  const mark = status.doubts.length === 0 ? "" : status.doubts.every((doubt) => doubt === "orders") ? "? " : "! ";
  return [mark, ...interval(status.axial_force_n, show)];
}

export const rodLink = (rod) => `/rod?id=${encodeURIComponent(rod)}`;

export const state = (status) => el("span", { class: `state ${status.state}` }, status.state.replace("-", " "));

export function why(status) {
  if (status.never_seen_since && !status.state_reason) return `never seen since ${time(status.never_seen_since)}`;
  if (status.baseline_records !== null) {
    const goals = status.learning_takes;
    return `baseline ${status.baseline_records}${goals ? ` of ${goals.records}` : ""} records, charts ${status.learned_periods}${goals ? ` of ${goals.periods}` : ""} periods`;
  }
  return status.state_reason;
}

export function alarmNote(alarm, link = true) {
  const known = alarm.acknowledged ? `, acknowledged ${time(alarm.acknowledged)}` : "";
  const over = alarm.cleared ? `, its condition ended ${time(alarm.cleared)}` : "";
  return el("div", { class: alarm.acknowledged ? "note calm" : "note" },
    el("strong", {}, `${alarm.kind}: `), alarm.message,
    el("div", { class: "about" }, `since ${time(alarm.raised)} UTC${known}${over} `,
      link ? el("a", { href: "/alarms" }, "alarms") : null));
}

// Fills the content, keeps the old one if the server cannot answer, and says so.
export function show(content, ...children) {
  content.replaceChildren(...children.flat());
  content.setAttribute("aria-busy", "false");
}

export function failed(content, error) {
  content.querySelector(".failed")?.remove();
  content.prepend(el("p", { class: "note failed", role: "alert" }, error.retryAfterS ? error.message : `The server did not answer: ${error.message}`));
  content.setAttribute("aria-busy", "false");
}

// Calls `draw` now and after every commit, one call at a time; a burst of commits ends in one call.
export function live(draw) {
  const light = document.getElementById("live");
  let isDrawing = false, isAsked = false;
  const redraw = async () => {
    if (isDrawing) { isAsked = true; return; }
    isDrawing = true;
    do {
      isAsked = false;
      try { await draw(); } catch (error) {
        failed(document.getElementById("content"), error);
        if (error.retryAfterS) setTimeout(redraw, 1000 * error.retryAfterS);
      }
    } while (isAsked);
    isDrawing = false;
  };
  const stream = new EventSource("/api/v1/events");
  stream.addEventListener("commit", () => {
    light.className = "on";
    light.textContent = "live";
    redraw();
  });
  stream.onerror = () => {
    light.className = "off";
    light.textContent = "not connected, trying again";
  };
  redraw();
}
