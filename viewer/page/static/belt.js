// The belt as the cameras see it: pictures of those on the screen, and of no others, with outlines and weights.
import { Late } from "./late.js";
import { known, ofTuber, t } from "./words.js";

const STALE_MS = 2500;
const LATE_S = 6; // pictures that wait so long on a slow link are left there for a new one
const REST_MS = 60;
const SETTLE_MS = 250; // while a person scrolls nothing is asked for
const FONT_PX = 13;
// A state has a colour, a line and a sign of its own: it can be told without colours.
const LOOKS = {
  seen: { colour: "#ffffff", dash: [5, 4], sign: "" },
  counted: { colour: "#7df08a", dash: [], sign: "" },
  lump: { colour: "#ff7a7a", dash: [2, 3], sign: "✕" },
  haulm: { colour: "#ff9df0", dash: [2, 3], sign: "✕" },
  left_out: { colour: "#b9bdb3", dash: [1, 4], sign: "" },
};
const shown = new Map(); // "line/camera" of each canvas that was made
const seen = new Set(); // those on the screen
let events = null;
let asked = "";
let settling = null;

const onScreen = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    if (entry.isIntersecting) seen.add(entry.target.dataset.see);
    else seen.delete(entry.target.dataset.see);
  }
  settle();
}, { rootMargin: "80px" });

export function beltPicture(canvas, line, camera) {
  const see = `${line}/${camera}`;
  if (canvas.dataset.see === see) return;
  forget(canvas);
  canvas.dataset.see = see;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", t("picture.none"));
  shown.set(see, { canvas, picture: null, image: null, cameAt: null, next: null, busy: false });
  onScreen.observe(canvas);
}

function forget(canvas) {
  onScreen.unobserve(canvas);
  shown.delete(canvas.dataset.see);
  seen.delete(canvas.dataset.see);
}

// What stands below a picture: how old it is, or why there is none.
export function pictureNote(see) {
  const view = shown.get(see);
  if (!view?.picture) return t("picture.none");
  const sinceMs = performance.now() - view.cameAt;
  if (sinceMs > STALE_MS) return t("picture.old", { for: sinceMs / 1000 });
  const what = `drop.${view.picture.drop}.what`;
  return view.picture.drop ? t("picture.dropped", { why: known(what) ? t(what) : view.picture.drop.replaceAll("_", " ") }) : "";
}

function settle() {
  clearTimeout(settling);
  settling = setTimeout(listen, SETTLE_MS);
}

function listen() {
  const wanted = document.hidden ? [] : [...seen].sort();
  const query = wanted.map((see) => `see=${encodeURIComponent(see)}`).join("&");
  if (query === asked && events?.readyState !== EventSource.CLOSED) return;
  asked = query;
  events?.close();
  events = query ? new EventSource(`pictures?${query}`) : null;
  if (!events) return;
  let late = new Late();
  events.onopen = () => { late = new Late(); };
  events.onmessage = (event) => {
    const picture = JSON.parse(event.data);
    const lateS = late.of(picture.sent_s);
    take({ ...picture, age_s: picture.age_s + lateS });
    if (lateS > LATE_S) lookAgain();
  };
  events.onerror = () => { if (events?.readyState === EventSource.CLOSED) setTimeout(settle, 3000); };
}

// On a connection of its own, where the one before is dead and nobody says so.
export function lookAgain() {
  asked = "";
  listen();
}

// A device that is slow to draw skips pictures: of those that come meanwhile the newest is next.
async function take(picture) {
  const view = shown.get(`${picture.line}/${picture.camera}`);
  if (!view) return;
  view.next = { ...picture, takenAt: performance.now() - 1000 * picture.age_s };
  if (view.busy) return;
  view.busy = true;
  try {
    while (view.next) {
      const next = view.next;
      view.next = null;
      await show(view, next);
      await new Promise((resolve) => setTimeout(() => requestAnimationFrame(resolve), REST_MS));
    }
  } finally {
    view.busy = false;
  }
}

async function show(view, picture) {
  const bytes = Uint8Array.from(atob(picture.jpeg), (letter) => letter.charCodeAt(0));
  const image = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
  view.image?.close();
  Object.assign(view, { picture, image, cameAt: picture.takenAt });
  draw(view);
}

function draw({ canvas, picture, image }) {
  const dots = Math.min(2, devicePixelRatio || 1);
  const wide = Math.round((canvas.clientWidth || picture.width) * dots);
  const scale = wide / picture.width;
  const high = Math.round(picture.height * scale);
  if (canvas.width !== wide || canvas.height !== high) Object.assign(canvas, { width: wide, height: high });
  const pen = canvas.getContext("2d", { willReadFrequently: true }); // small: no work for a weak graphics chip
  pen.drawImage(image, 0, 0, wide, high);
  for (const outline of picture.outlines) line(pen, outline, scale, dots);
  for (const outline of picture.outlines) label(pen, outline, scale, dots);
  canvas.dataset.seq = picture.seq;
  canvas.dataset.outlines = picture.outlines.length;
  canvas.setAttribute("aria-label", said(picture));
}

// In another unit: a camera that is away sends no picture that would say it.
export function drawAgain() {
  for (const view of shown.values()) if (view.image) draw(view);
}

function line(pen, [state, , corners], scale, dots) {
  const look = LOOKS[state] ?? LOOKS.seen;
  pen.beginPath();
  for (let n = 0; n < corners.length; n += 2) pen.lineTo((corners[n] + 0.5) * scale, (corners[n + 1] + 0.5) * scale);
  pen.closePath();
  pen.lineJoin = "round";
  pen.setLineDash([]);
  Object.assign(pen, { lineWidth: 4 * dots, strokeStyle: "rgb(0 0 0 / .55)" });
  pen.stroke();
  pen.setLineDash(look.dash.map((long) => long * dots));
  Object.assign(pen, { lineWidth: 2 * dots, strokeStyle: look.colour });
  pen.stroke();
  pen.setLineDash([]);
}

// Its weight on what is counted, with "~" before they are final; a cross on what was refused.
function label(pen, [state, weight_g, corners], scale, dots) {
  const look = LOOKS[state] ?? LOOKS.seen;
  const words = look.sign || (weight_g === null || state === "left_out" ? "" : `${state === "counted" ? "" : "~"}${ofTuber(weight_g)}`);
  if (!words) return;
  let [left, right, top, bottom] = [Infinity, -Infinity, Infinity, -Infinity];
  for (let n = 0; n < corners.length; n += 2) {
    [left, right] = [Math.min(left, corners[n]), Math.max(right, corners[n])];
    [top, bottom] = [Math.min(top, corners[n + 1]), Math.max(bottom, corners[n + 1])];
  }
  Object.assign(pen, { font: `700 ${FONT_PX * dots}px system-ui, sans-serif`, textAlign: "center", textBaseline: "middle", lineWidth: 3.5 * dots, strokeStyle: "rgb(0 0 0 / .8)", fillStyle: look.colour });
  if (!look.sign && pen.measureText(words).width > 1.3 * (right - left) * scale) return; // it would hide its neighbours
  const at = [((left + right) / 2) * scale, ((top + bottom) / 2) * scale];
  pen.strokeText(words, ...at);
  pen.fillText(words, ...at);
}

function said(picture) {
  const count = (...states) => picture.outlines.filter(([state]) => states.includes(state)).length;
  return t("picture.said", { camera: picture.camera, counted: count("counted"), seen: count("seen"), refused: count("lump", "haulm") });
}

document.addEventListener("visibilitychange", settle);
