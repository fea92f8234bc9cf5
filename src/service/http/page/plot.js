// A plot as SVG: lines with bands, points, marks, a time or number axis, zoom by dragging, export as CSV, SVG or PNG.

import { el, fixed, grouped } from "./common.js";

const DAY = 86_400_000;
const MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];
const FONT = 12;
const pen = document.createElement("canvas").getContext("2d");

function svg(name, attributes = {}, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

function width(text) {
  // The family is read once: each reading of a style makes the browser lay the page out.
  if (!pen.isSet) {
    pen.font = `${FONT}px ${getComputedStyle(document.body).fontFamily}`;
    pen.isSet = true;
  }
  return pen.measureText(text).width;
}

const clean = (value, step) => fixed(value, Math.min(Math.max(0, Math.ceil(-Math.log10(step) - 1e-9)), 9)).replaceAll(",", "\u202f");

// Ticks at 1, 2 or 5 times a power of ten.
function numberTicks([low, high], most) {
  const rough = (high - low) / Math.max(most, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * ([1, 2, 5, 10].find((factor) => factor * power >= rough) ?? 10);
  const ticks = [];
  for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9 * step; n += 1) ticks.push([n * step, clean(n * step + 0, step)]);
  return ticks;
}

function powerTicks([low, high], most) {
  const step = Math.max(1, Math.ceil((high - low) / Math.max(most, 1)));
  const ticks = [];
  for (let n = Math.ceil(low); n <= high; n += 1) {
    if (n % step === 0) ticks.push([n, n >= -3 && n <= 3 ? String(Number((10 ** n).toPrecision(1))) : `1e${n}`]);
  }
  return ticks;
}

const STEPS = [1e3, 5e3, 15e3, 30e3, 6e4, 3e5, 9e5, 18e5, 36e5, 72e5, 216e5, 432e5, DAY, 2 * DAY, 7 * DAY, 14 * DAY];
const two = (n) => String(n).padStart(2, "0");

// Ticks at even times of UTC, each with its label and, where it changes, the day or the year beneath.
function timeTicks([low, high], most) {
  const span = (high - low) / Math.max(most, 1);
  const step = STEPS.find((step) => step >= 0.9 * span);
  const times = [];
  if (step) {
    const from = step >= 7 * DAY ? 4 * DAY : 0; // weeks begin on Monday
    for (let t = Math.ceil((low - from) / step) * step + from; t <= high; t += step) times.push(t);
  } else {
    const months = [1, 2, 3, 6, 12, 24, 60, 120, 240, 600, 1200].find((count) => count * 30.44 * DAY >= span) ?? 2400;
    const begin = (n) => Date.UTC(Math.floor(n / 12), n % 12);
    const first = new Date(low);
    for (let n = Math.floor((first.getUTCFullYear() * 12 + first.getUTCMonth()) / months) * months; begin(n) <= high; n += months) {
      if (begin(n) >= low) times.push(begin(n));
    }
  }
  let last = null;
  return times.map((t) => {
    const d = new Date(t);
    const day = `${d.getUTCDate()} ${MONTHS[d.getUTCMonth()]}`, year = String(d.getUTCFullYear());
    let label, under;
    if (step && step < DAY) {
      label = `${two(d.getUTCHours())}:${two(d.getUTCMinutes())}${step < 6e4 ? `:${two(d.getUTCSeconds())}` : ""}`;
      under = `${day} ${year}`;
    } else if (step) [label, under] = [day, year];
    else [label, under] = [MONTHS[d.getUTCMonth()], year];
    const changed = under !== last;
    last = under;
    return [t, label, changed ? under : ""];
  });
}

export const stamp = (ms) => new Date(ms).toISOString().slice(0, 16).replace("T", " ");

// Stretches of a series without a gap: index ranges [from, to) of existing values at most four times the usual distance apart.
export function stretches(x, y, isTime) {
  const found = [];
  const steps = x.slice(1).map((v, i) => v - x[i]).sort((a, b) => a - b);
  const far = isTime && steps.length > 2 ? 4 * steps[Math.floor(steps.length / 2)] : Infinity;
  for (let from = 0; from < x.length; from += 1) {
    if (y[from] === null) continue;
    let to = from + 1;
    while (to < x.length && y[to] !== null && x[to] - x[to - 1] <= far) to += 1;
    found.push([from, to]);
    from = to - 1;
  }
  return found;
}

function save(name, blob) {
  const link = el("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

const SYMBOLS = {
  cross: (x, y) => `M${x - 4} ${y - 4}l8 8m0 -8l-8 8`,
  down: (x, y) => `M${x - 5} ${y - 9}h10l-5 8z`,
  up: (x, y) => `M${x - 5} ${y + 5}h10l-5 -9z`,
  check: (x, y) => `M${x - 5} ${y}l4 4l6 -9`,
  ring: (x, y) => `M${x - 4} ${y}a4 4 0 1 0 8 0a4 4 0 1 0 -8 0`,
  diamond: (x, y) => `M${x} ${y - 5}l5 5l-5 5l-5 -5z`,
};

// A figure that is drawn into again and again. A series: name, `key` if its name may change, shade, x, y and, if it has any, low and high, `line`, `points`,
// `symbol`, `labels`, `notes`, `saved`, `off`. A spec: x and y ({title, isTime, isLog, range}), series, stretches, levels, events, zoom.
export class Plot {
  // Id of the rod that the plots are of.
  static owner = "";

  constructor(id, caption, isLow = false) {
    this.id = id;
    this.off = new Map();
    this.legend = el("div", { class: "legend", role: "group", "aria-label": "Lines shown" });
    this.words = el("figcaption", { id: `${id}-caption` }, caption);
    this.tip = el("div", { class: "tip", hidden: true });
    this.plot = el("div", { id, class: isLow ? "plot low" : "plot" }, this.tip);
    const button = (name, what) => el("button", { type: "button", "aria-label": `save ${id} as ${name}`, onclick: what }, name);
    this.whole = el("button", { type: "button", class: "whole", hidden: true, onclick: () => this.zoom(null) }, "whole figure");
    this.element = el("figure", {}, this.legend, this.plot, this.words, el("div", { class: "save" }, "save ",
      button("CSV", () => save(this.file("csv"), new Blob([this.csv()], { type: "text/csv" }))),
      button("SVG", () => save(this.file("svg"), new Blob([this.picture()], { type: "image/svg+xml" }))),
      button("PNG", () => this.png()), this.whole));
    // It calls at once, too: what is drawn in this size already stays.
    new ResizeObserver(() => {
      if (this.plot.clientWidth !== this.size?.[0] || this.plot.clientHeight !== this.size[1]) this.render();
    }).observe(this.plot);
    this.listen();
  }

  // Name of a saved file: `south-relative.csv`.
  file(ending) { return `${[Plot.owner, this.id].filter(Boolean).join("-").replace(/[^\p{L}\p{N}._-]+/gu, "-")}.${ending}`; }

  draw(spec) {
    // A stretch of one quantity is none of another.
    if (spec.x.title !== this.spec?.x.title) this.own = null;
    this.spec = spec;
    for (const one of spec.series) {
      one.key ??= one.name;
      if (!this.off.has(one.key)) this.off.set(one.key, Boolean(one.off));
    }
    this.legend.replaceChildren(...(spec.series.length < 2 ? [] : spec.series.map((one) => el("button", {
      type: "button", "aria-pressed": String(!this.off.get(one.key)), class: `s-${one.shade}`,
      onclick: () => { this.off.set(one.key, !this.off.get(one.key)); this.draw(this.spec); },
    }, one.name))));
    this.render();
  }

  shown() { return this.spec.series.filter((one) => !this.off.get(one.key)); }

  range() {
    const { x } = this.spec;
    const isSeen = ([from, to]) => this.spec.series.some((one) => one.x.some((at, i) => at >= from && at <= to && one.y[i] !== null));
    if (this.own && !isSeen(this.own)) this.own = null;
    this.whole.hidden = !this.own;
    if (this.own) return this.own;
    if (x.range) return x.range;
    const all = this.spec.series.flatMap((one) => one.x.filter((_, i) => one.y[i] !== null));
    const [low, high] = [Math.min(...all), Math.max(...all)];
    const pad = x.pad * (high - low || 1) || 0;
    return [low - pad, high + pad];
  }

  // Range of the values visible in the range of x, and of the levels; a single value gets a margin.
  heights([from, to]) {
    const { y, levels = [] } = this.spec;
    if (y.range) return y.range;
    let low = Infinity, high = -Infinity;
    const take = (value) => { if (value !== null && Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); } };
    for (const one of this.shown()) {
      one.x.forEach((at, i) => {
        if (at < from || at > to || one.y[i] === null) return;
        take(one.y[i]);
        if (one.low) { take(one.low[i]); take(one.high[i]); }
      });
    }
    if (low > high) return [0, 1];
    levels.forEach((level) => take(level.at));
    if (y.zero) take(0);
    const pad = 0.06 * (high - low) || 0.05 * Math.abs(high) || 1;
    return [y.zero && low >= 0 ? 0 : low - pad, high + pad];
  }

  render() {
    const { spec, plot } = this;
    const [w, h] = [plot.clientWidth, plot.clientHeight];
    this.size = [w, h];
    if (!spec || w < 50) return;
    const [from, to] = this.range();
    const [bottom, top] = this.heights([from, to]);
    const events = spec.events ?? [];
    const yTicks = (spec.y.isLog ? powerTicks : numberTicks)([bottom, top], h / 36);
    const marginLeft = spec.y.isBare ? 26 : 34 + Math.max(...yTicks.map(([, label]) => width(label)), 8);
    const box = { x: marginLeft, y: events.length ? 24 : 10, w: w - marginLeft - 12 };
    box.h = h - box.y - (spec.x.title ? 42 : 40);
    const X = (value) => box.x + (box.w * (value - from)) / (to - from || 1);
    const Y = (value) => box.y + (box.h * (top - (spec.y.isLog ? Math.log10(value) : value))) / (top - bottom || 1);
    this.scale = { box, X, Y, from, to };
    plot.dataset.axes = JSON.stringify({ x: [from, to], y: [bottom, top], box });
    const within = (value) => value >= from && value <= to;
    const line = (x1, y1, x2, y2, kind) => svg("line", { x1, y1, x2, y2, class: kind });
    const text = (x, y, kind, content, more = {}) => svg("text", { x, y, class: kind, ...more }, content);

    const grid = svg("g", { class: "grid" });
    for (const [value, label] of yTicks) {
      const y = box.y + (box.h * (top - value)) / (top - bottom || 1);
      grid.append(line(box.x, y, box.x + box.w, y, value === 0 && !spec.y.isLog ? "zero" : "rule"));
      if (!spec.y.isBare) grid.append(text(box.x - 6, y + 4, "end", label));
    }
    const most = box.w / (spec.x.isTime ? 74 : 64);
    for (const [value, label, under] of (spec.x.isTime ? timeTicks : numberTicks)([from, to], most)) {
      const half = width(label) / 2, x = Math.min(Math.max(X(value), half), w - half);
      grid.append(line(X(value), box.y, X(value), box.y + box.h, "rule"), text(x, box.y + box.h + 16, "middle", label));
      if (under) grid.append(text(Math.min(Math.max(X(value), width(under) / 2), w - width(under) / 2), box.y + box.h + 32, "middle soft", under));
    }
    grid.append(line(box.x, box.y + box.h, box.x + box.w, box.y + box.h, "axis"));
    if (spec.x.title) grid.append(text(box.x + box.w / 2, h - 6, "middle soft", spec.x.title));
    const middle = box.y + box.h / 2;
    grid.append(text(13, middle, "middle soft", spec.y.title, { transform: `rotate(-90 13 ${middle})` }));

    const inside = svg("g", { "clip-path": `url(#${this.id}-clip)` });
    for (const { from: a, to: b, shade, isEdged } of spec.stretches ?? []) {
      inside.append(svg("rect", { x: X(a), y: box.y, width: Math.max(X(b) - X(a), 1), height: box.h, class: `stretch s-${shade}${isEdged ? " edged" : ""}` }));
    }
    const names = [];
    for (const { at, label, shade } of spec.levels ?? []) {
      inside.append(line(box.x, Y(at), box.x + box.w, Y(at), `level s-${shade}`));
      const below = Y(at) - box.y < 18;
      names.push(text(spec.y.isLog ? box.x + 4 : box.x + box.w - 4, Y(at) + (below ? 14 : -5), `${spec.y.isLog ? "" : "end "}halo s-${shade} tinted`, label));
    }
    for (const { at, shade, isDashed } of events.filter((event) => event.isLine)) {
      inside.append(line(X(at), box.y, X(at), box.y + box.h, `event s-${shade}${isDashed ? " dashed" : ""}`));
    }
    for (const one of this.shown()) inside.append(...this.series(one, X, Y));

    const strip = svg("g", { class: "strip" });
    for (const event of events.filter(({ at }) => within(at))) {
      strip.append(svg("path", { d: SYMBOLS[event.symbol](X(event.at), 13), class: `symbol s-${event.shade} ${event.symbol}` }, svg("title", {}, event.text)));
    }
    const clip = svg("clipPath", { id: `${this.id}-clip` }, svg("rect", { x: box.x, y: box.y, width: box.w, height: box.h }));
    const cursor = svg("line", { class: "cursor", y1: box.y, y2: box.y + box.h, visibility: "hidden" });
    const chosen = svg("rect", { class: "chosen", y: box.y, height: box.h, width: 0 });
    const picture = svg("svg", { viewBox: `0 0 ${w} ${h}`, width: w, height: h, role: "img", "aria-labelledby": `${this.id}-caption` },
      svg("defs", {}, clip), grid, inside, ...names, this.labels(X, Y, box), strip, cursor, chosen);
    Object.assign(this, { cursor, chosen });
    plot.querySelector("svg")?.remove();
    plot.prepend(picture);
  }

  series(one, X, Y) {
    const { from, to } = this.scale;
    const parts = [], kind = `s-${one.shade}`;
    const there = one.x.reduce((count, at, i) => count + (at >= from && at <= to && one.y[i] !== null), 0);
    const bits = one.line === false ? [] : stretches(one.x, one.y, this.spec.x.isTime);
    const path = (indices, values) => indices.map((i, n) => `${n ? "L" : "M"}${X(one.x[i]).toFixed(2)} ${Y(values[i]).toFixed(2)}`).join("");
    const indices = ([a, b]) => [...Array(b - a).keys()].map((i) => a + i);
    if (one.low) {
      const d = bits.map((bit) => `${path(indices(bit), one.high)}${path(indices(bit).reverse(), one.low).replace("M", "L")}Z`).join("");
      if (d) parts.push(svg("path", { d, class: `band ${kind}` }));
      // An isolated value has no width, so its interval is a bar.
      const alone = one.line === false ? one.x.map((_, i) => [i, i + 1]).filter(([i]) => one.y[i] !== null) : bits.filter(([a, b]) => b - a === 1);
      const bars = alone.map(([i]) => `M${X(one.x[i]).toFixed(2)} ${Y(one.low[i]).toFixed(2)}V${Y(one.high[i]).toFixed(2)}`).join("");
      if (bars) parts.push(svg("path", { d: bars, class: `bar ${kind}` }));
    }
    if (one.fill) {
      const floor = this.scale.box.y + this.scale.box.h;
      const d = bits.map((bit) => `${path(indices(bit), one.y)}V${floor}H${X(one.x[bit[0]]).toFixed(2)}Z`).join("");
      parts.push(svg("path", { d, class: `band ${kind}` }));
    }
    if (bits.length) parts.push(svg("path", { d: bits.map((bit) => path(indices(bit), one.y)).join(""), class: `line ${kind}${one.isDashed ? " dashed" : ""}` }));
    const marked = one.x.map((_, i) => i).filter((i) => one.y[i] !== null);
    if (one.symbol) {
      parts.push(...marked.map((i) => svg("path", { d: SYMBOLS[one.symbol](X(one.x[i]), Y(one.y[i])), class: `symbol ${kind} ${one.symbol}` })));
    } else if (one.points !== false && (one.points || there <= 200)) {
      parts.push(svg("path", { d: marked.map((i) => `M${X(one.x[i]).toFixed(2)} ${Y(one.y[i]).toFixed(2)}h0`).join(""), class: `dots ${kind}` }));
    }
    return parts;
  }

  // Names above the points, in up to three rows; a name that would cover another is omitted (the caption has them all).
  labels(X, Y, box) {
    const group = svg("g", {}), placed = [];
    for (const one of this.shown().filter((one) => one.labels)) {
      one.x.forEach((at, i) => {
        if (X(at) < box.x || X(at) > box.x + box.w || !one.labels[i]) return;
        const half = width(one.labels[i]) / 2;
        const x = Math.min(Math.max(X(at), box.x + half), box.x + box.w - half);
        const y = [0, 1, 2].map((row) => Y(one.y[i]) - 13 - 14 * row)
          .find((y) => y > box.y + 2 && placed.every((p) => Math.abs(p.x - x) > p.half + half + 6 || Math.abs(p.y - y) >= 13));
        if (y === undefined) return;
        placed.push({ x, y, half });
        group.append(svg("text", { x, y, class: "middle halo" }, one.labels[i]));
      });
    }
    return group;
  }

  listen() {
    const { plot } = this;
    let start = null;
    const at = (event) => {
      const { box, from, to } = this.scale;
      const px = Math.min(Math.max(event.clientX - plot.getBoundingClientRect().left, box.x), box.x + box.w);
      return { px, value: from + ((to - from) * (px - box.x)) / box.w };
    };
    plot.addEventListener("pointerdown", (event) => {
      if (!this.scale || event.button !== 0) return;
      start = at(event);
      plot.setPointerCapture(event.pointerId);
    });
    plot.addEventListener("pointermove", (event) => {
      if (!this.scale) return;
      const { px } = at(event);
      if (start && Math.abs(px - start.px) > 4) {
        this.chosen.setAttribute("x", Math.min(px, start.px));
        this.chosen.setAttribute("width", Math.abs(px - start.px));
      }
      this.point(event, px);
    });
    plot.addEventListener("pointerup", (event) => {
      if (start) {
        const end = at(event);
        this.chosen.setAttribute("width", 0);
        if (Math.abs(end.px - start.px) > 8) this.zoom([start.value, end.value].sort((a, b) => a - b));
      }
      start = null;
    });
    plot.addEventListener("pointercancel", () => { start = null; this.chosen?.setAttribute("width", 0); });
    plot.addEventListener("pointerleave", () => { this.tip.hidden = true; this.cursor?.setAttribute("visibility", "hidden"); });
    plot.addEventListener("dblclick", () => this.zoom(null));
  }

  zoom(range) {
    if (this.spec.zoom) return this.spec.zoom(range);
    this.own = range;
    this.render();
  }

  // Nearest point: its position, and every line's value there.
  point(event, px) {
    const { X, Y, box } = this.scale;
    const py = event.clientY - this.plot.getBoundingClientRect().top;
    let best = null;
    for (const one of this.shown()) {
      one.x.forEach((at, i) => {
        if (one.y[i] === null || X(at) < box.x - 1 || X(at) > box.x + box.w + 1) return;
        const far = this.spec.isClosest ? Math.hypot(X(at) - px, Y(one.y[i]) - py) : Math.abs(X(at) - px);
        if (!best || far < best.far) best = { far, at, one, i };
      });
    }
    const isNear = best && best.far < 40;
    this.tip.hidden = !isNear;
    this.cursor.setAttribute("visibility", isNear ? "visible" : "hidden");
    if (!isNear) return;
    this.cursor.setAttribute("x1", X(best.at));
    this.cursor.setAttribute("x2", X(best.at));
    const digits = this.spec.y.digits ?? 3;
    const said = (value) => (Math.abs(value) >= 1e5 || (value && Math.abs(value) < 1e-3) ? value.toPrecision(3) : fixed(value, digits));
    const rows = this.spec.isClosest ? [[best.one, best.i]]
      : this.shown().map((one) => [one, one === best.one ? best.i : one.x.findIndex((x, i) => x === best.at && one.y[i] !== null)]).filter(([, i]) => i >= 0);
    this.tip.replaceChildren(
      el("strong", {}, this.spec.x.isTime ? `${stamp(best.at)} UTC` : `${fixed(best.at, this.spec.x.digits ?? 3)} ${this.spec.x.unit ?? ""}`),
      ...rows.map(([one, i]) => el("div", { class: `s-${one.shade}` }, `${one.name}: ${said(one.y[i])}`,
        one.low ? ` (${said(one.low[i])} to ${said(one.high[i])})` : "", one.notes?.[i] ? `, ${one.notes[i]}` : "")));
    const left = X(best.at) > this.plot.clientWidth / 2;
    this.tip.style.left = left ? "" : `${X(best.at) + 10}px`;
    this.tip.style.right = left ? `${this.plot.clientWidth - X(best.at) + 10}px` : "";
  }

  // The values between the ends of the axis, one row per place on it.
  csv() {
    const { from, to } = this.scale, { x } = this.spec;
    const shown = this.shown();
    const places = [...new Set(shown.flatMap((one) => one.x.filter((at, i) => at >= from && at <= to && one.y[i] !== null)))].sort((a, b) => a - b);
    const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
    const unit = /\[.*\]/.exec(this.spec.y.title)?.[0] ?? "";
    // `saved`: the same values in another unit.
    const saved = shown.map((one) => ({ unit, ...one, ...one.saved }));
    const heads = saved.flatMap((one) => [...["", ...(one.low ? [" 2.5 %", " 97.5 %"] : [])].map((end) => `${one.name}${end} ${one.unit}`.trim()), ...(one.notes ? [`${one.name}: note`] : [])]);
    // Points without a line share places: each has a row of its own.
    const found = shown.map((one) => grouped(one.x.map((_, i) => i).filter((i) => one.y[i] !== null), (i) => one.x[i]));
    const turns = (at) => [...Array(Math.max(...found.map((of) => of.get(at)?.length ?? 0))).keys()];
    const rows = places.flatMap((at) => turns(at).map((turn) => [at, turn])).map(([at, turn]) => [x.isTime ? new Date(at).toISOString() : at, ...saved.flatMap((one, n) => {
      const i = found[n].get(at)?.[turn];
      const columns = [one.y, ...(one.low ? [one.low, one.high] : []), ...(one.notes ? [one.notes] : [])];
      return columns.map((column) => (i === undefined ? "" : column[i] ?? ""));
    })]);
    return [[x.isTime ? "time (UTC)" : x.title, ...heads], ...rows].map((row) => row.map((cell) => quoted(String(cell))).join(",")).join("\r\n") + "\r\n";
  }

  // The picture with its colours embedded, and with the names of its lines and its caption below.
  picture() {
    const seen = this.plot.querySelector("svg"), copy = seen.cloneNode(true);
    const originals = seen.querySelectorAll("*");
    copy.querySelectorAll("*").forEach((element, i) => {
      const style = getComputedStyle(originals[i]);
      for (const name of ["fill", "stroke", "stroke-width", "stroke-dasharray", "stroke-linecap", "stroke-linejoin", "fill-opacity", "text-anchor", "font-size", "paint-order"]) {
        element.setAttribute(name, style.getPropertyValue(name));
      }
    });
    copy.querySelectorAll(".cursor, .chosen").forEach((element) => element.remove());
    const body = getComputedStyle(document.body), w = this.plot.clientWidth, h = this.plot.clientHeight;
    const colour = (shade) => getComputedStyle(document.documentElement).getPropertyValue(`--${shade}`).trim();
    const lines = [];
    for (const word of [Plot.owner ? `${Plot.owner}:` : "", this.words.textContent].join(" ").trim().split(" ")) {
      const line = `${lines.at(-1) ?? ""} ${word}`;
      if (lines.length && width(line) < w - 20) lines[lines.length - 1] = line; else lines.push(word);
    }
    const many = this.shown().length > 1 ? this.shown() : [];
    const height = h + 18 * many.length + 18 * lines.length + 14;
    const under = (y, text, fill) => svg("text", { x: 10, y, "font-size": FONT, fill }, text);
    copy.append(...many.map((one, i) => under(h + 14 + 18 * i, `\u2014 ${one.name}`, colour(one.shade))),
      ...lines.map((line, i) => under(h + 14 + 18 * (many.length + i), line.trim(), colour("soft"))));
    copy.prepend(svg("rect", { width: w, height, fill: body.backgroundColor }));
    for (const [name, value] of Object.entries({ xmlns: "http://www.w3.org/2000/svg", "font-family": body.fontFamily, width: w, height, viewBox: `0 0 ${w} ${height}` })) copy.setAttribute(name, value);
    return new XMLSerializer().serializeToString(copy);
  }

  png() {
    const image = new Image();
    image.onload = () => {
      const canvas = el("canvas", { width: 2 * image.width, height: 2 * image.height });
      canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
      canvas.toBlob((blob) => save(this.file("png"), blob), "image/png");
    };
    image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(this.picture())}`;
  }
}
