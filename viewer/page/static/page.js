// Takes the snapshots as they come and says at every moment how old they are. It asks for nothing else.
import { drawAgain } from "./belt.js";
import { LineCard } from "./card.js";
import { openMenu } from "./menu.js";
import { ago, t } from "./words.js";

const LOST_S = 4; // the server sends at least every 2 s
const RETRY_MS = 2000;
const lines = document.getElementById("lines");
const contact = document.getElementById("contact");
const spoken = document.getElementById("spoken");
const cards = new Map();
let heardAt = null; // performance.now() of the last snapshot
let saidBefore = "";

function listen() {
  const events = new EventSource("events");
  events.onmessage = (event) => {
    heardAt = performance.now();
    show(JSON.parse(event.data));
  };
  events.onerror = () => {
    if (events.readyState === EventSource.CLOSED) setTimeout(listen, RETRY_MS);
  };
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
  const sinceS = heardAt === null ? null : (performance.now() - heardAt) / 1000;
  const lost = sinceS !== null && sinceS > LOST_S;
  for (const card of cards.values()) card.age(sinceS, lost);
  const gone = [...cards].filter(([, card]) => card.gone).map(([line]) => line);
  const state = sinceS === null ? "wait" : lost || gone.length ? "trouble" : "good";
  contact.dataset.state = state;
  const text = lost ? t("contact.lost", { for: sinceS }) : gone.length ? t("contact.gone", { lines: gone.join(", ") }) : t(`contact.${state}`);
  contact.querySelector(".text").textContent = text;
  document.body.dataset.contact = lost ? "lost" : "live";
  say(lost);
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
setInterval(tick, 500);
