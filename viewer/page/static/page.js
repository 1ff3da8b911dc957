// Takes the snapshots as they come and says at every moment how old they are. It asks for nothing else.
import { drawAgain, lookAgain } from "./belt.js";
import { LineCard } from "./card.js";
import { Late } from "./late.js";
import { openMenu } from "./menu.js";
import { ago, t } from "./words.js";

const LOST_S = 4; // the server sends at least every 2 s
const RETRY_MS = 2000;
const SILENT_S = 12; // after a hole in the radio a browser may wait for minutes on a connection that is dead
const lines = document.getElementById("lines");
const contact = document.getElementById("contact");
const spoken = document.getElementById("spoken");
const cards = new Map();
let events = null;
let askedAt = 0; // performance.now() when the stream was asked for
let heardAt = null; // when the last snapshot was sent: {ms: performance.now(), clockMs: Date.now()}
let shownAt = -Infinity; // when this tab came to the front
let saidBefore = "";

// A tab in the background asks for nothing: a browser has six connections for all its tabs.
function listen() {
  events?.close();
  events = document.hidden ? null : new EventSource("events");
  askedAt = performance.now();
  if (!events) return;
  const mine = events;
  let late = new Late();
  mine.onopen = () => { late = new Late(); }; // again, perhaps to a server that was started again
  mine.onmessage = (event) => {
    const found = JSON.parse(event.data);
    const lateMs = 1000 * late.of(found.sent_s);
    heardAt = { ms: performance.now() - lateMs, clockMs: Date.now() - lateMs };
    show(found);
  };
  mine.onerror = () => {
    if (mine.readyState === EventSource.CLOSED) setTimeout(() => mine === events && listen(), RETRY_MS);
  };
}

// A device that sleeps does not count the seconds, but its clock goes on.
function sinceHeardS() {
  return heardAt && Math.max(performance.now() - heardAt.ms, Date.now() - heardAt.clockMs) / 1000;
}

function show(snapshot) {
  const told = new Set(snapshot.lines.map((found) => found.line));
  for (const [line, card] of cards) {
    if (told.has(line)) continue; // the page was started again, for other lines
    card.element.remove();
    cards.delete(line);
  }
  for (const found of snapshot.lines) {
    if (!cards.has(found.line)) {
      const card = new LineCard(document.getElementById("line"));
      cards.set(found.line, card);
      lines.append(card.element);
    }
    cards.get(found.line).take(found);
  }
  document.body.dataset.lines = cards.size;
  tick();
}

function tick() {
  if (document.hidden) return;
  const sinceS = sinceHeardS();
  const askedS = (performance.now() - askedAt) / 1000;
  const lost = sinceS !== null && sinceS > LOST_S;
  if (askedS > SILENT_S && (sinceS === null || sinceS > SILENT_S)) {
    listen();
    lookAgain();
  }
  for (const card of cards.values()) card.age(sinceS, lost);
  const gone = [...cards].filter(([, card]) => card.gone).map(([line]) => line);
  const back = lost && performance.now() - shownAt < 1000 * LOST_S; // nothing can have come yet
  const state = sinceS === null || back ? "wait" : lost || gone.length ? "trouble" : "good";
  contact.dataset.state = state;
  const text = back ? t("contact.wait") : lost ? t("contact.lost", { for: sinceS }) : gone.length ? t("contact.gone", { lines: gone.join(", ") }) : t(`contact.${state}`);
  contact.querySelector(".text").textContent = text;
  document.body.dataset.contact = lost ? "lost" : "live";
  say(lost && !back);
}

// For screen readers: alarms once when they come, not every second with a new duration.
function say(lost) {
  const parts = lost ? [t("spoken.lost")] : [...cards.values()].map((card) => card.said());
  const now = parts.filter(Boolean).join(" ");
  if (now !== saidBefore) spoken.textContent = now || t("alarms.none");
  saidBefore = now;
}

openMenu(() => {
  for (const card of cards.values()) card.again();
  drawAgain();
  tick();
});
listen();
document.addEventListener("visibilitychange", () => {
  if (!document.hidden) shownAt = performance.now();
  listen();
});
setInterval(tick, 500);
