// Orders of a person: start, end, undo, ticket, note. Each is confirmed in a dialog and sent once, however often it is tried.
import { apart, chosen, inKilograms, inUnit, number, t, translate } from "./words.js";

const dialog = document.getElementById("order");
const form = dialog.querySelector("form");
const inputs = form.elements;
const wrong = dialog.querySelector(".wrong");
const TAKES_MS = 30000;
let order = null; // what the open dialog is about: {line, action, done, names}, and its last try: {content, request, pressedAt, unsure}

export function ask(line, action, found, done) {
  order = { line, action, done, content: null, names: (found.told ?? []).map(({ name }) => name) };
  form.reset();
  translate(dialog);
  dialog.querySelector("h2").textContent = t(`ask.${action}`);
  const told = found.told ?? [];
  const open = found.now || (!found.load && told.some((load) => load.open)); // the list is older than the figures
  const ends = action === "start" && open;
  dialog.querySelector(".what").textContent = [t(`ask.${action}.what`), ends ? t("ask.start.ends") : ""].filter(Boolean).join(" ");
  dialog.querySelector(".yes").textContent = t(`ask.${action}.yes`);
  dialog.querySelector(".unit").textContent = t("ask.kg", { unit: chosen().unit });
  for (const part of dialog.querySelectorAll("[data-for]")) part.hidden = !part.dataset.for.split(" ").includes(action);
  inputs.kg.required = action === "ticket";
  inputs.note.required = action === "note";
  if (action === "start" && told.length) [inputs.field.value, inputs.variety.value] = [told[0].field, told[0].variety];
  if (action === "ticket" || action === "note") choose(told, action);
  inputs.operator.value = kept(localStorage, "operator");
  inputs.token.value = kept(sessionStorage, "token");
  inputs.token.parentElement.hidden = inputs.token.value !== "";
  say("");
  dialog.showModal();
}

// For a ticket the newest load that has ended and has none yet stands first, for a note the open one.
function choose(told, action) {
  const named = (load) => [load.number, load.name && `· ${apart(load.name)}`, load.open && t("open_load")].filter(Boolean).join(" ");
  inputs.load.replaceChildren(...told.map((load) => new Option(named(load), load.number)));
  const next = told.find((load) => (action === "note" ? load.open : !load.open && load.net_g === null && load.gross_g === null));
  if (next) inputs.load.value = next.number;
}

// The same again is one order, however often it is tried; what was corrected is another one.
function said() {
  const found = asked();
  const content = JSON.stringify(found);
  if (content !== order.content) Object.assign(order, { content, request: newRequest(), pressedAt: performance.now(), unsure: false });
  return { ...found, request: order.request, operator: inputs.operator.value.trim(), age_s: Math.min(3600, (performance.now() - order.pressedAt) / 1000) };
}

function asked() {
  const { line, action } = order;
  const found = { line, action };
  const load = `number:${inputs.load.value}`; // another load may have this number as its name
  if (action === "start") found.fields = Object.fromEntries(["name", "field", "variety"].map((name) => [name, inputs[name].value.trim()]));
  if (action === "ticket") Object.assign(found, { load, kg: inKilograms(figure(inputs.kg.value)), net: !inputs.gross.checked });
  if (action === "note") Object.assign(found, { load, note: inputs.note.value.trim() });
  return found;
}

// A point or a comma before the decimals; NaN where it is no number.
export function figure(text) {
  const plain = text.replace(/\s/g, "").replace(",", ".");
  return /^\d+(\.\d+)?$/.test(plain) ? Number(plain) : NaN;
}

async function send() {
  const { unit } = chosen();
  if (order.action === "ticket" && Number.isNaN(figure(inputs.kg.value))) return correct(inputs.kg, t("ask.number", { unit, example: number(unit === "t" ? 8.123 : 8123.5, unit === "t" ? 3 : 1) }));
  if (order.action === "note" && !inputs.note.value.trim()) return correct(inputs.note, t("ask.empty"));
  const mine = order; // another dialog may be open when the answer comes
  const button = dialog.querySelector(".yes");
  button.disabled = true;
  say(t("ask.waiting"), "wait");
  const answer = await post(said(), inputs.token.value);
  button.disabled = false;
  if (mine !== order) { // its dialog was closed: it may be carried out all the same
    if (answer.done) told(mine, answer);
    return;
  }
  if (answer.status === 401) {
    keep(sessionStorage, "token", "");
    inputs.token.parentElement.hidden = false;
    inputs.token.select();
  } else if (answer.status) {
    keep(sessionStorage, "token", inputs.token.value);
    keep(localStorage, "operator", inputs.operator.value.trim());
  }
  if (answer.done) {
    order = null;
    dialog.close();
    told(mine, answer);
    return;
  }
  // Refused: the next try is another order. Unless one may be done: then only the line can say that it is not.
  if (answer.unsure || answer.status === 200) mine.unsure = Boolean(answer.unsure);
  if (!mine.unsure) mine.content = null;
  say(answer.status === 401 ? t("refused.token") : answer.told ? answer.error : t("refused.line", { why: inUnit(answer.error, mine.names) }));
}

function told(mine, answer) {
  mine.done(`${t(`done.${mine.action}`, { n: answer.load })} ${t("refused.line", { why: inUnit(answer.text, [...mine.names, answer.name]) })}`);
}

// What is to be typed otherwise, and where.
function correct(input, text) {
  input.focus();
  say(text);
}

async function post(body, token) {
  const unsure = { done: false, unsure: true };
  if (!sendable(token)) return { done: false, status: 401 };
  try {
    const found = await fetch("order", {
      method: "POST", body: JSON.stringify(body), signal: AbortSignal.timeout(TAKES_MS),
      headers: { "Content-Type": "application/json", "X-Tuberline-Token": token },
    });
    const known = (found.headers.get("content-type") ?? "").startsWith("application/json");
    if (!known && found.status < 500) return { done: false, told: true, error: t("ask.looks_only") };
    if (!known) return { ...unsure, told: true, error: t("ask.unsure") };
    const answer = await found.json();
    return { ...(found.status === 502 || answer.later ? unsure : {}), status: found.status, ...answer };
  } catch {
    return { ...unsure, told: true, error: t("ask.unsure") };
  }
}

// No header holds what is outside Latin-1, such as a dash that a phone made of a minus; no server has seen such a token.
function sendable(token) {
  try {
    return new Headers({ "X-Tuberline-Token": token }) !== null;
  } catch {
    return false;
  }
}

function newRequest() {
  return `page-${[...crypto.getRandomValues(new Uint8Array(12))].map((byte) => byte.toString(16).padStart(2, "0")).join("")}`;
}

function say(text, kind = "trouble") {
  wrong.hidden = text === "";
  wrong.dataset.kind = kind;
  wrong.textContent = text;
  if (text) wrong.scrollIntoView({ block: "nearest" });
}

function kept(store, name) {
  try {
    return store.getItem(name) ?? "";
  } catch {
    return ""; // storage is switched off
  }
}

function keep(store, name, text) {
  try {
    store.setItem(name, text);
  } catch {
    // typed again next time
  }
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  send();
});
dialog.querySelector(".no").addEventListener("click", () => dialog.close());
dialog.addEventListener("close", () => {
  dialog.querySelector(".yes").disabled = false;
  if (!dialog.open) order = null; // told later: the next order may be asked for already
});
