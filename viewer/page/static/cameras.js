// A card for each camera with what it does now; in a table of its own everything that ever went wrong, by reason.
import { beltPicture, pictureNote } from "./belt.js";
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

export function cameraCards(place, line, cameras) {
  while (place.children.length > cameras.length) place.lastElementChild.remove();
  cameras.forEach((camera, n) => {
    if (!place.children[n]) place.append(blank());
    draw(place.children[n], line, camera);
  });
}

function blank() {
  const card = document.createElement("div");
  card.className = "camera";
  card.innerHTML = "<h4></h4><p class='pill'><span class='sign' aria-hidden='true'></span><span class='text'></span></p><canvas width='16' height='9'></canvas><p class='note'></p><p class='now'></p>";
  return card;
}

function draw(card, line, camera) {
  const [state, text] = STATES[camera.state] ?? ["trouble", camera.state];
  put(card.querySelector("h4"), camera.name);
  card.querySelector(".pill").dataset.state = state;
  put(card.querySelector(".pill .text"), text);
  const over = camera.state === "ended";
  card.querySelector("canvas").hidden = card.querySelector(".note").hidden = over;
  if (!over) beltPicture(card.querySelector("canvas"), line, camera.name);
  if (!over) put(card.querySelector(".note"), pictureNote(`${line}/${camera.name}`));
  put(card.querySelector(".now"), `${number(camera.tubers)} tubers${camera.state === "ok" ? `, ${number(camera.per_s, 1)} frames a second` : ""}`);
}

export function cameraRows(cameras) {
  return cameras.map((camera) => [
    camera.name, camera.state === "ended" ? "–" : number(camera.per_s, 1), number(camera.processed), number(camera.published),
    camera.age_ms === null ? "–" : `${number(camera.age_ms)} ms`,
    camera.drift_mm === null ? "–" : `${camera.drift_mm > 0 ? "+" : ""}${number(camera.drift_mm, 1)} mm`, lost(camera),
  ]);
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
