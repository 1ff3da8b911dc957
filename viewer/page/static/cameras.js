// A card for each camera: what it does now in one row, and everything that ever went wrong below, by reason.
import { number } from "./words.js";

const STATES = {
  ok: ["good", "Working"],
  streaming: ["good", "Working"],
  ended: ["good", "Ended"],
  waiting: ["wait", "Not there yet"],
  starting: ["wait", "Starting"],
  silent: ["trouble", "Silent"],
  gone: ["trouble", "Gone"],
  stalled: ["trouble", "Hangs"],
  failed: ["trouble", "Failed"],
  trouble: ["trouble", "Trouble"],
};

export function cameraCards(place, cameras) {
  while (place.children.length > cameras.length) place.lastElementChild.remove();
  cameras.forEach((camera, n) => {
    if (!place.children[n]) place.append(blank());
    draw(place.children[n], camera);
  });
}

function blank() {
  const card = document.createElement("div");
  card.className = "camera";
  card.innerHTML = "<h4></h4><p class='pill'><span class='sign' aria-hidden='true'></span><span class='text'></span></p><dl></dl><p class='lost'></p>";
  return card;
}

function draw(card, camera) {
  const [state, text] = STATES[camera.state] ?? ["trouble", camera.state];
  put(card.querySelector("h4"), camera.name);
  card.querySelector(".pill").dataset.state = state;
  put(card.querySelector(".pill .text"), text);
  const rows = [
    ["Frames a second", camera.state === "ended" ? "–" : number(camera.per_s, 1)],
    ["Frames used", number(camera.processed)],
    ["Frames taken", number(camera.published)],
    ["Tubers", number(camera.tubers)],
    ["Frame age", camera.age_ms === null ? "–" : `${number(camera.age_ms)} ms`],
    ["Belt off by", camera.drift_mm === null ? "–" : `${camera.drift_mm > 0 ? "+" : ""}${number(camera.drift_mm, 1)} mm`],
  ];
  const list = card.querySelector("dl");
  rows.forEach(([name, value], n) => {
    if (!list.children[n]) {
      const row = document.createElement("div");
      row.append(document.createElement("dt"), document.createElement("dd"));
      list.append(row);
    }
    put(list.children[n].firstChild, name);
    put(list.children[n].lastChild, value);
  });
  put(card.querySelector(".lost"), lost(camera));
}

function lost(camera) {
  const parts = [
    ...(camera.gaps ? [`${number(camera.gaps)} frames lost on the way`] : []),
    ...Object.entries(camera.drops).map(([why, n]) => `${number(n)} frames not used: ${why}`),
    ...Object.entries(camera.refused).map(([why, n]) => `${number(n)} frames unreadable: ${why.replaceAll("_", " ")}`),
    ...Object.entries(camera.views_lost).map(([why, n]) => `${number(n)} views not weighed: ${why}`),
  ];
  return parts.length ? `${parts.join("; ")}.` : "No frame lost, none left out.";
}

function put(place, text) {
  if (place.textContent !== text) place.textContent = text;
}
