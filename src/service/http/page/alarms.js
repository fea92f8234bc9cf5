// The alarms: those that stand, those that are over, and who knows of them.

import { ask, el, live, rodLink, show, table, time } from "./common.js";

const content = document.getElementById("content");
const said = el("p", { role: "status", id: "said" });
const standing = el("button", { type: "button", "aria-pressed": "true", onclick: () => pick(true) }, "standing");
const all = el("button", { type: "button", "aria-pressed": "false", onclick: () => pick(false) }, "all");
const list = el("div", {});
const more = el("button", { type: "button", hidden: true, onclick: () => { pages += 1; draw(); } }, "older ones");
let onlyStanding = true, pages = 1;

function pick(only) {
  onlyStanding = only;
  pages = 1;
  standing.setAttribute("aria-pressed", String(only));
  all.setAttribute("aria-pressed", String(!only));
  draw();
}

// The token stays with this tab and is asked for once.
function token() {
  const kept = sessionStorage.getItem("token");
  if (kept) return Promise.resolve(kept);
  return new Promise((resolve) => {
    const field = el("input", { type: "password", id: "token", autocomplete: "off", required: true });
    const dialog = el("dialog", { "aria-labelledby": "token-title" },
      el("h2", { id: "token-title" }, "Token"),
      el("p", {}, "Acknowledging needs the token of this site: the line in the file that http.token_file names."),
      el("form", { method: "dialog" }, el("label", { for: "token" }, "Token "), field,
        el("div", { class: "tools" }, el("button", { value: "ok" }, "Go on"), el("button", { value: "", formnovalidate: true }, "Cancel"))));
    dialog.addEventListener("close", () => {
      const value = dialog.returnValue === "ok" ? field.value : null;
      if (value) sessionStorage.setItem("token", value);
      dialog.remove();
      resolve(value);
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}

async function acknowledge(alarm) {
  const secret = await token();
  if (!secret) return;
  try {
    const path = `/api/v1/alarms/${encodeURIComponent(alarm.id)}/acknowledge`;
    const answer = await ask(path, { method: "POST", headers: { authorization: `Bearer ${secret}` } });
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
    cell("is", stands, el("small", {}, alarm.acknowledged ? `acknowledged ${time(alarm.acknowledged)}` : "",
      alarm.cleared ? ` ended ${time(alarm.cleared)}` : "")),
    el("td", {}, alarm.acknowledged || !alarm.stands ? "" : el("button", {
      type: "button", "aria-label": `acknowledge ${alarm.kind} of ${alarm.rod}, raised ${time(alarm.raised)}`,
      onclick: () => acknowledge(alarm),
    }, "acknowledge")));
}

async function draw() {
  let alarms = [], before = "", next = null;
  for (let page = 0; page < pages; page += 1) {
    const answer = await ask(`/api/v1/alarms?limit=100&standing=${onlyStanding}${before}`);
    alarms = alarms.concat(answer.alarms);
    next = answer.next;
    if (!next) break;
    before = `&before=${encodeURIComponent(next)}`;
  }
  more.hidden = !next;
  list.replaceChildren(alarms.length
    ? table("Times are UTC, those of the data that raised it.", [["raised"], ["rod"], ["kind"], ["what it says"], ["is"], [""]], alarms.map(row))
    : el("p", {}, onlyStanding ? "No alarm stands." : "There was no alarm."));
  content.querySelector(".failed")?.remove();
}

show(content, el("div", { class: "tools", role: "group", "aria-label": "Which alarms" }, standing, all), said, list, more);
live(draw);
