// Orders of a person: start, end, undo, ticket. Each is confirmed in a dialog and sent once, however often it is tried.
const dialog = document.getElementById("order");
const form = dialog.querySelector("form");
const inputs = form.elements;
const wrong = dialog.querySelector(".wrong");
const TAKES_MS = 30000;
const WORDS = {
  start: ["Start a load", "What lies below the cameras from the moment you press the button belongs to it. The open load ends there.", "Start load now"],
  end: ["End the load", "What comes from now on belongs to no load, until the next one starts.", "End load now"],
  undo: ["Undo the last change", "The last start or end of a load is taken back. Its tubers go where they would have gone.", "Undo now"],
  ticket: ["Enter a ticket", "What the scale said of a load. A second ticket takes the place of the first.", "Enter ticket"],
};
let order = null; // what the open dialog is about: {line, action, request, pressedAt, done}

export function ask(line, action, found, done) {
  const [title, what, yes] = WORDS[action];
  order = { line, action, request: null, pressedAt: 0, done };
  form.reset();
  dialog.querySelector("h2").textContent = title;
  dialog.querySelector(".what").textContent = what;
  dialog.querySelector(".yes").textContent = yes;
  for (const part of dialog.querySelectorAll("[data-for]")) part.hidden = part.dataset.for !== action;
  inputs.kg.required = action === "ticket";
  const told = found.told ?? [];
  if (action === "start" && told.length) [inputs.field.value, inputs.variety.value] = [told[0].field, told[0].variety];
  if (action === "ticket") choose(told);
  inputs.operator.value = kept(localStorage, "operator");
  inputs.token.value = kept(sessionStorage, "token");
  inputs.token.parentElement.hidden = inputs.token.value !== "";
  say("");
  dialog.showModal();
}

// The newest load that has ended and has no ticket yet stands first.
function choose(told) {
  inputs.load.replaceChildren(...told.map((load) => new Option(`${load.number}${load.name ? ` · ${load.name}` : ""}${load.open ? " (open)" : ""}`, load.number)));
  const next = told.find((load) => !load.open && load.net_g === null && load.gross_g === null);
  if (next) inputs.load.value = next.number;
}

function said() {
  const { line, action } = order;
  if (order.request === null) Object.assign(order, { request: newRequest(), pressedAt: performance.now() });
  const found = { line, action, request: order.request, operator: inputs.operator.value.trim(), age_s: Math.min(3600, (performance.now() - order.pressedAt) / 1000) };
  if (action === "start") found.fields = Object.fromEntries(["name", "field", "variety"].map((name) => [name, inputs[name].value.trim()]));
  if (action === "ticket") Object.assign(found, { load: inputs.load.value, kg: kilograms(inputs.kg.value), net: !inputs.gross.checked });
  return found;
}

// A point or a comma before the decimals; NaN where it is no number.
export function kilograms(text) {
  const plain = text.replace(/\s/g, "").replace(",", ".");
  return /^\d+(\.\d+)?$/.test(plain) ? Number(plain) : NaN;
}

async function send() {
  if (order.action === "ticket" && Number.isNaN(kilograms(inputs.kg.value))) return say("Type the weight in kg as a number, for example 8123 or 8123,5.");
  const mine = order; // another dialog may be open when the answer comes
  const button = dialog.querySelector(".yes");
  button.disabled = true;
  say("Asking the line …", "wait");
  const answer = await post(said(), inputs.token.value);
  button.disabled = false;
  if (mine !== order) return;
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
    mine.done(answer.text);
    return;
  }
  if (!answer.unsure) mine.request = null; // refused: the next try is another order
  say(answer.error);
}

async function post(body, token) {
  const unsure = { done: false, unsure: true };
  try {
    const found = await fetch("order", {
      method: "POST", body: JSON.stringify(body), signal: AbortSignal.timeout(TAKES_MS),
      headers: { "Content-Type": "application/json", Authorization: `Bearer ${token}` },
    });
    const known = (found.headers.get("content-type") ?? "").startsWith("application/json");
    if (!known) return { done: false, error: "At this address the page only looks: its server takes no orders here." };
    return { ...(found.status === 502 ? unsure : {}), status: found.status, ...(await found.json()) };
  } catch {
    return { ...unsure, error: "The page's server did not answer. It is not known whether the order arrived: press again, it is carried out once." };
  }
}

function newRequest() {
  return `page-${[...crypto.getRandomValues(new Uint8Array(12))].map((byte) => byte.toString(16).padStart(2, "0")).join("")}`;
}

function say(text, kind = "trouble") {
  wrong.hidden = text === "";
  wrong.dataset.kind = kind;
  wrong.textContent = text;
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
dialog.addEventListener("close", () => { order = null; dialog.querySelector(".yes").disabled = false; });
