// Plots of single records of a rod: the latest identified one and the latest rejected one.

import { el, fixed, kilonewtons, share, table, time } from "./common.js";
import * as figures from "./figures.js";
import { Plot } from "./plot.js";

const waveform = new Plot("waveform", "The latest identified record about its mean.", true);
const spectrum = new Plot("spectrum", "", false);
const density = new Plot("density", "", false);
const hangsOn = el("div", { id: "hangs-on", hidden: true });
const choice = el("select", { id: "quantity", onchange: () => drawDensity() });
const quantityChoice = el("div", { class: "tools" }, el("label", { for: "quantity" }, "Quantity "), choice);
const title = el("h2", { id: "latest-title" }, "Latest record"), words = el("p", { id: "latest-words" });
const refusedTitle = el("h2", { id: "refused-title" }, "Latest rejected record"), refusedWords = el("div", { id: "refused-words" });
const refusedWaveform = new Plot("refused-waveform", "The latest rejected record about its mean.", true);
const refusedSpectrum = new Plot("refused-spectrum", "");
const refusedPeaks = el("div", { id: "refused-peaks" });
let look = null;

export const parts = [
  title, words, el("div", { class: "pair" }, waveform.element, spectrum.element), quantityChoice, density.element, hangsOn,
  refusedTitle, refusedWords, el("div", { class: "pair" }, refusedWaveform.element, refusedSpectrum.element), refusedPeaks,
];

// Draws the snapshots of a rod's records that the server keeps.
export function draw(answer) {
  look = answer.latest;
  for (const element of [waveform.element, spectrum.element, density.element, quantityChoice]) element.hidden = !look;
  title.textContent = look ? `Latest record: ${time(look.start)} UTC, ${fixed(look.duration_s, 0)} s at ${fixed(look.fs_hz, 0)} Hz` : "No record identified yet";
  words.textContent = look ? motionAndLabels(look) : "";
  drawSources(look?.hangs_on);
  drawRefused(answer);
  if (!look) return;
  waveform.element.hidden = !look.waveform;
  if (look.waveform) figures.waveform(waveform, look.waveform, answer.unit);
  const modes = look.peaks.filter((peak) => peak.order !== null).map((peak) => `${peak.order}: ${peak.frequency_hz.toFixed(3)} Hz`);
  spectrum.words.textContent = `Power spectral density of the latest identified record. Modes: ${modes.join(", ")}.`;
  figures.spectrum(spectrum, look);
  const quantities = look.densities.map((d) => d.quantity), kept = choice.value;
  choice.replaceChildren(...quantities.map((key) => el("option", { value: key }, figures.quantity(key)[0])));
  if (quantities.includes(kept)) choice.value = kept;
  drawDensity();
}

function drawDensity() {
  const chosen = look.densities.find((d) => d.quantity === choice.value) ?? look.densities[0];
  quantityChoice.hidden = density.element.hidden = !chosen;
  if (!chosen) return;
  const [title, factor] = figures.quantity(chosen.quantity);
  const said = ([mean, sd]) => {
    const digits = Math.min(Math.max(1 - Math.floor(Math.log10(sd * factor)), 0), 6);
    return `${fixed(mean * factor, digits)} \u00b1 ${fixed(sd * factor, digits)}`;
  };
  density.words.textContent = `Posterior against prior: ${title}, prior ${said(chosen.prior_mean_sd)}, posterior ${said(chosen.posterior_mean_sd)} (mean \u00b1 standard deviation).`;
  figures.density(density, chosen);
}

// Sources whose name for people is not their key.
const SOURCES = { rigidity: "flexural rigidity", mass: "mass per length", springs: "supports", measurement: "measured frequencies", discrepancy: "model's discrepancy" };

function drawSources(sources) {
  hangsOn.hidden = !sources;
  if (!sources) return;
  const percents = (name, value) => el("td", { class: "n", "data-name": name }, `${fixed(100 * value, 0)} %`);
  hangsOn.replaceChildren(
    table("What the force hangs on: shares of its variance.", [["source"], ["share", "n"], ["less variance if known", "n"]],
      sources.sources.map((part) => el("tr", {}, el("td", {}, SOURCES[part.source] ?? part.source), percents("share", part.share), percents("less variance if known", part.if_known)))),
    ...sources.said.map((sentence) => el("p", {}, `${sentence}.`)));
}

const MOTION = { ambient: "ambient vibration", "free-decay": "a free decay", "free-decays": "several free decays", blow: "ambient vibration with blows" };

// `a free decay from 2.31 s`
function motionSaid(motion) {
  const onsets = motion.onsets_s.slice(0, 4).map((s) => s.toFixed(2)).join(", ");
  const more = motion.onsets_s.length > 4 ? ` and ${motion.onsets_s.length - 4} more` : "";
  return `${MOTION[motion.kind] ?? motion.kind}${onsets ? ` ${motion.kind === "blow" ? "at" : "from"} ${onsets} s${more}` : ""}`;
}

function motionAndLabels(look) {
  const motion = look.excitation ? `The record shows ${motionSaid(look.excitation)}. ` : "";
  const labels = look.label_probability === undefined ? "" : `The orders of its modes are right with a probability of ${share(look.label_probability)}.`;
  return motion + labels;
}

// Possible assignments of peaks to modes, each with the force it gives.
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

// The latest rejected record: the reason, and its plots.
function drawRefused(answer) {
  const look = answer.refused;
  for (const element of [refusedTitle, refusedWords, refusedPeaks]) element.hidden = !look;
  const hasSpectrum = Boolean(look?.curve.level_db.length);
  refusedSpectrum.element.hidden = !hasSpectrum;
  refusedWaveform.element.hidden = !look?.waveform;
  if (!look) return;
  refusedTitle.textContent = `Latest rejected record: ${time(look.start)} UTC, ${fixed(look.duration_s, 0)} s at ${fixed(look.fs_hz, 0)} Hz`;
  refusedWords.replaceChildren(el("p", { class: "note" }, el("strong", {}, `${look.rejection.code}: `), look.rejection.message),
    el("p", {}, look.excitation ? `The record shows ${motionSaid(look.excitation)}.` : ""), ...(look.candidates ? [candidateTable(look.candidates)] : []));
  if (look.waveform) figures.waveform(refusedWaveform, look.waveform, answer.unit);
  if (hasSpectrum) {
    const peaks = look.peaks.map((peak) => `${peak.frequency_hz.toFixed(3)}${peak.taken_for ? ` (${peak.taken_for})` : ""}`);
    refusedSpectrum.words.textContent = `Power spectral density of the latest rejected record. Peaks [Hz]: ${peaks.join(", ") || "none"}.`;
    figures.spectrum(refusedSpectrum, look);
  }
  refusedPeaks.replaceChildren(peakTable(look.peaks));
}
