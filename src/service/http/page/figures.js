// The plots of a rod's page, in the page's colours; every figure has a caption that says in words what it shows.

/* global Plotly */
import { el } from "./common.js";

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

// A colour of the page with an opacity.
function faint(name, opacity) {
  const [r, g, b] = colour(name).match(/[0-9a-f]{2}/gi).map((part) => parseInt(part, 16));
  return `rgba(${r},${g},${b},${opacity})`;
}

const config = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["lasso2d", "select2d", "autoScale2d"] };

function layout(title, extra = {}) {
  const axis = { gridcolor: colour("grid"), linecolor: colour("rule"), zerolinecolor: colour("rule"), automargin: true };
  return {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: colour("ink"), family: getComputedStyle(document.body).fontFamily, size: 13 },
    margin: { l: 60, r: 16, t: 12, b: 44 }, hovermode: "x unified", hoverlabel: { bgcolor: colour("card"), font: { color: colour("ink") } },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("soft"), activecolor: colour("ink") },
    legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, showlegend: true, uirevision: "same",
    ...extra,
    xaxis: { ...axis, ...extra.xaxis }, yaxis: { ...axis, title: { text: title }, ...extra.yaxis },
  };
}

// A figure to be drawn into again and again.
export function figure(id, caption, low = false) {
  const plot = el("div", { id, class: low ? "plot low" : "plot", role: "img", "aria-labelledby": `${id}-caption` });
  const words = el("figcaption", { id: `${id}-caption` }, caption);
  return { element: el("figure", {}, plot, words), plot, words };
}

const react = (plot, traces, lay) => Plotly.react(plot, traces, lay, config);

// One closed outline around each stretch without a gap.
function around(time, low, high) {
  const x = [], y = [];
  for (let from = 0; from < time.length; from += 1) {
    let to = from;
    while (to < time.length && low[to] !== null) to += 1;
    if (to === from) continue;
    const stretch = [...Array(to - from).keys()].map((i) => from + i);
    const back = stretch.toReversed();
    x.push(...stretch.map((i) => time[i]), ...back.map((i) => time[i]), null);
    y.push(...stretch.map((i) => high[i]), ...back.map((i) => low[i]), null);
    from = to;
  }
  return { x, y };
}

function band(time, values, name, shade, scale, more = {}) {
  const scaled = (list) => list.map((value) => (value === null ? null : scale(value)));
  const outline = { mode: "lines", line: { width: 0 }, hoverinfo: "skip", showlegend: false, fill: "toself", fillcolor: faint(shade, 0.2) };
  return [
    { ...outline, ...around(time, scaled(values.q025), scaled(values.q975)) },
    { x: time, y: scaled(values.mean), name, mode: time.length > 400 ? "lines" : "lines+markers", connectgaps: false,
      line: { color: colour(shade), width: 1.4 }, marker: { size: 4, color: colour(shade) }, ...more },
  ];
}

// Vertical lines where alarms were raised, a stretch for the baseline.
function marks(rod, alarms) {
  const line = (time) => ({ type: "line", xref: "x", yref: "paper", x0: time, x1: time, y0: 0, y1: 1, line: { color: colour("alarm"), width: 1.3 } });
  const stretch = ([x0, x1]) => ({ type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, fillcolor: faint("c3", 0.13), line: { width: 0 }, layer: "below" });
  const baselines = rod.segments.map((segment) => segment.baseline).filter(Boolean);
  return [...baselines.map(stretch), ...alarms.map((alarm) => line(alarm.raised))];
}

const drawn = (values) => values.mean.some((value) => value !== null);

export function relative(plot, rod, history, alarms, range) {
  const percent = (ratio) => (ratio - 1) * 100;
  const traces = [];
  if (drawn(history.relative_force_at_reference)) traces.push(...band(history.time, history.relative_force_at_reference, "at reference temperature", "c1", percent));
  if (drawn(history.relative_force)) {
    const measured = band(history.time, history.relative_force, "at measured temperature", "c2", percent);
    if (traces.length) measured[1].visible = "legendonly";
    traces.push(...(traces.length ? measured.slice(1) : measured));
  }
  const aside = history.time.flatMap((time, i) => (history.set_aside[i] && history.relative_force.mean[i] !== null ? [[time, percent(history.relative_force.mean[i]), history.set_aside[i]]] : []));
  if (aside.length) {
    traces.push({ x: aside.map((a) => a[0]), y: aside.map((a) => a[1]), text: aside.map((a) => a[2]), name: "set aside", mode: "markers",
      marker: { symbol: "x", color: colour("soft"), size: 6 } });
  }
  return react(plot, traces, layout("change of force [%]", { shapes: marks(rod, alarms), xaxis: { type: "date", range } }));
}

export function absolute(plot, rod, history, range) {
  const kN = (newtons) => newtons / 1e3;
  const traces = [];
  if (drawn(history.axial_force_n)) traces.push(...band(history.time, history.axial_force_n, "each record alone", "c4", kN));
  const tracked = drawn(history.force_at_reference_n) ? history.force_at_reference_n : history.tracked_force_n;
  if (drawn(tracked)) traces.push(...band(history.time, tracked, "given the baseline", "c1", kN));
  return react(plot, traces, layout("force [kN]", { xaxis: { type: "date", range } }));
}

export function temperature(plot, history, range) {
  const trace = { x: history.time, y: history.temperature_c, name: "temperature", mode: "lines", line: { color: colour("c2"), width: 1.4 } };
  return react(plot, [trace], layout("temperature [\u00b0C]", { showlegend: false, xaxis: { type: "date", range } }));
}

// Each detector's statistic over its limit, on a logarithmic scale: an alarm is a line that crosses one.
export function charts(plot, chart, range) {
  const traces = [];
  const add = (name, values, shade) => {
    if (values.some((value) => value !== null)) {
      const y = values.map((value) => (value === null ? null : Math.min(Math.max(value, 1e-5), 1e3)));
      traces.push({ x: chart.time, y, name, mode: "lines", line: { color: colour(shade), width: 1.4 } });
    }
  };
  add("temperature and other rods", chart.evidence, "c1");
  add("other rods alone", chart.evidence_peers, "c2");
  add("this rod alone", chart.evidence_blind, "c3");
  const limit = { type: "line", xref: "paper", x0: 0, x1: 1, y0: 1, y1: 1, line: { color: colour("alarm"), width: 1.3, dash: "dash" } };
  return react(plot, traces, layout("evidence / limit", { shapes: [limit], xaxis: { type: "date", range }, yaxis: { type: "log", range: [-4.2, 2.2], autorange: false } }));
}

export function waveform(plot, waveform, unit) {
  const largest = Math.max(...waveform.high.map(Math.abs), ...waveform.low.map(Math.abs), 1e-30);
  const [factor, prefix] = [[1, ""], [1e3, "m"], [1e6, "\u00b5"], [1e9, "n"]].find(([f]) => largest * f >= 1) ?? [1e9, "n"];
  const x = [], y = [];
  waveform.low.forEach((low, i) => {
    x.push(i * waveform.step_s, (i + 0.5) * waveform.step_s);
    y.push(low * factor, waveform.high[i] * factor);
  });
  const trace = { x, y, mode: "lines", line: { color: colour("c1"), width: 1 }, name: "samples", hoverinfo: "x+y" };
  return react(plot, [trace], layout(unit ? `${prefix}${unit}` : "signal", { showlegend: false, hovermode: "closest", xaxis: { title: { text: "time [s]" } } }));
}

export function spectrum(plot, snapshot) {
  const { first_hz: first, step_hz: step, level_db: level } = snapshot.curve;
  const x = level.map((_, i) => first + i * step);
  const at = (frequency) => level[Math.min(Math.max(Math.round((frequency - first) / step), 0), level.length - 1)];
  const labels = snapshot.peaks.filter((peak) => peak.order !== null);
  const others = snapshot.peaks.filter((peak) => peak.order === null);
  const points = (peaks, name, symbol, shade, text) => ({
    x: peaks.map((peak) => peak.frequency_hz), y: peaks.map((peak) => at(peak.frequency_hz)), text: peaks.map(text), name, mode: "markers+text",
    textposition: "top center", cliponaxis: false, marker: { symbol, size: 9, color: colour(shade) }, hovertemplate: "%{x:.3f} Hz %{text}<extra></extra>",
  });
  const traces = [{ x, y: level, mode: "lines", name: "power spectral density", line: { color: colour("c1"), width: 1.2 } }];
  if (labels.length) traces.push(points(labels, "modes", "triangle-down", "c3", (peak) => `${peak.order}: ${peak.frequency_hz.toFixed(3)} Hz`));
  const named = (peak) => (peak.line ? "tone" : labels.length ? "" : `${peak.frequency_hz.toFixed(3)} Hz`);
  if (others.length) traces.push(points(others, labels.length ? "not of the rod" : "peaks", "x", "soft", named));
  const levels = level.filter((value) => value > -390);
  const top = Math.max(...levels), low = Math.min(...levels);
  return react(plot, traces, layout("level [dB]", { hovermode: "closest", xaxis: { title: { text: "frequency [Hz]" } }, yaxis: { range: [low - 3, top + 0.15 * (top - low) + 3] } }));
}

const UNITS = { axial_force_n: ["axial force [kN]", 1e-3], youngs_modulus_pa: ["Young's modulus [GPa]", 1e-9], density_kg_m3: ["density [kg/m\u00b3]", 1], side_m: ["side [mm]", 1e3] };
export function quantity(key) {
  return UNITS[key] ?? [key.replaceAll("_", " "), 1];
}

export function density(plot, density) {
  const [title, factor] = quantity(density.quantity);
  const count = density.prior.length;
  const x = density.prior.map((_, i) => factor * (density.low + (density.high - density.low) * i / (count - 1)));
  const trace = (y, name, shade, fill) => ({ x, y, name, mode: "lines", line: { color: colour(shade), width: 1.5 }, fill: fill ? "tozeroy" : "none", fillcolor: faint(shade, 0.18) });
  return react(plot, [trace(density.prior, "prior", "soft", false), trace(density.posterior, "posterior", "c1", true)],
    layout("density", { hovermode: "closest", xaxis: { title: { text: title } }, yaxis: { showticklabels: false, rangemode: "tozero" } }));
}
