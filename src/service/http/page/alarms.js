// The alarms: active, over, and acknowledged ones.

import { ask, el, live, rodLink, show, table, time } from "./common.js";
import { siteAtCentre } from "./place.js";

const content = document.getElementById("content");
const said = el("p", { role: "status", id: "said" });
const standing = el("button", { type: "button", "aria-pressed": "true", onclick: () => pick(true) }, "standing");
const all = el("button", { type: "button", "aria-pressed": "false", onclick: () => pick(false) }, "all");
const list = el("div", {});
const more = el("button", { type: "button", hidden: true, onclick: () => { pages += 1; redraw(); } }, "older ones");
let onlyStanding = true, pages = 1;

function pick(only) {
  onlyStanding = only;
  pages = 1;
  standing.setAttribute("aria-pressed", String(only));
  all.setAttribute("aria-pressed", String(!only));
  redraw();
}

// Asks for name, note and token of an acknowledgement; null if cancelled. Name and token are kept in this tab.
function signature(alarm) {
  return new Promise((resolve) => {
    const kept = (key) => sessionStorage.getItem(key) ?? "";
    const by = el("input", { id: "by", autocomplete: "name", maxlength: 80, value: kept("by") });
    const note = el("input", { id: "note", autocomplete: "off", maxlength: 160 });
    const token = el("input", { type: "password", id: "token", autocomplete: "off", required: true, value: kept("token") });
    const field = (input, words) => el("div", {}, el("label", { for: input.id }, words), input);
    const dialog = el("dialog", { "aria-labelledby": "ask-title" },
      el("h2", { id: "ask-title" }, `Acknowledge ${alarm.kind} of ${alarm.rod}`),
      el("form", { method: "dialog" }, field(by, "Your name"), field(note, "What there is to say (optional)"),
        field(token, "Token of this site: the line in the file that http.token_file names"),
        el("div", { class: "tools" }, el("button", { value: "ok" }, "Acknowledge"), el("button", { value: "", formnovalidate: true }, "Cancel"))));
    dialog.addEventListener("close", () => {
      const isMeant = dialog.returnValue === "ok";
      if (isMeant) for (const input of [by, token]) sessionStorage.setItem(input.id, input.value);
      dialog.remove();
      resolve(isMeant ? { by: by.value, note: note.value, token: token.value } : null);
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}

async function acknowledge(alarm) {
  const signed = await signature(alarm);
  if (!signed) return;
  try {
    const words = new URLSearchParams(["by", "note"].filter((key) => signed[key].trim()).map((key) => [key, signed[key].trim()]));
    const path = `api/v1/alarms/${encodeURIComponent(alarm.id)}/acknowledge?${words}`;
    const answer = await ask(path, { method: "POST", headers: { authorization: `Bearer ${signed.token}` } });
    said.textContent = `Alarm ${alarm.id} of ${alarm.rod}: acknowledged (${answer.when}).`;
  } catch (error) {
    if (error.status === 401) sessionStorage.removeItem("token");
    said.textContent = `Alarm ${alarm.id} of ${alarm.rod}: ${error.message}`;
  }
}

function row(alarm) {
  const cell = (name, ...children) => el("td", { "data-name": name }, ...children);
  const stands = alarm.stands ? (alarm.acknowledged ? "stands, acknowledged" : "stands") : "over";
  return el("tr", { "data-alarm": alarm.id, "data-stands": stands },
    el("td", { "data-name": "raised", class: "nowrap" }, time(alarm.raised)),
    el("td", { "data-name": "rod" }, el("a", { href: rodLink(alarm.rod) }, alarm.rod)),
    cell("kind", alarm.kind),
    cell("says", alarm.message),
    cell("is", stands, alarm.acknowledged ? el("small", {}, `acknowledged ${time(alarm.acknowledged)}`) : null,
      alarm.acknowledged_words ? el("small", {}, alarm.acknowledged_words) : null,
      alarm.cleared ? el("small", {}, `condition ended ${time(alarm.cleared)}`) : null),
    el("td", {}, alarm.acknowledged || !alarm.stands ? "" : toDo(alarm)));
}

// A centre acknowledges by a signed command to the site; its page can change nothing.
function toDo(alarm) {
  if (siteAtCentre) return el("small", {}, "acknowledge it with ", el("code", {}, `tirante hub command ${siteAtCentre} acknowledge ${alarm.id} --by NAME --reason TEXT`));
  return el("button", {
    type: "button", "aria-label": `acknowledge ${alarm.kind} of ${alarm.rod}, raised ${time(alarm.raised)}`,
    onclick: () => acknowledge(alarm),
  }, "acknowledge");
}

async function draw() {
  const only = onlyStanding;
  let alarms = [], before = "", next = null;
  for (let page = 0; page < pages; page += 1) {
    const answer = await ask(`api/v1/alarms?limit=100&standing=${only}${before}`);
    // The other button was pressed meanwhile: it is drawn next.
    if (only !== onlyStanding) return;
    alarms = alarms.concat(answer.alarms);
    next = answer.next;
    if (!next) break;
    before = `&before=${encodeURIComponent(next)}`;
  }
  more.hidden = !next;
  list.replaceChildren(alarms.length
    ? table("Times are UTC, those of the data that raised it.", [["raised"], ["rod"], ["kind"], ["what it says"], ["is"], ["to do"]], alarms.map(row))
    : el("p", {}, only ? "No alarm stands." : "There was no alarm."));
}

show(content, el("div", { class: "tools", role: "group", "aria-label": "Which alarms" }, standing, all), said, list, more);
const redraw = live(draw);
