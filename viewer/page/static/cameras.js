// A card for each camera with what it does now; in a table of its own everything that ever went wrong, by reason.
import { beltPicture, pictureNote } from "./belt.js";
import { known, number, t } from "./words.js";

const STATES = {
  ok: ["good", "ok"],
  streaming: ["good", "ok"],
  ended: ["good", "ended"],
  waiting: ["wait", "waiting"],
  starting: ["wait", "starting"],
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
  card.innerHTML = "<h4></h4><p class='pill'><span class='sign' aria-hidden='true'></span><span class='text'></span></p><canvas width='16' height='9'></canvas><p class='note'></p><p class='now'></p><p class='scaled' hidden></p>";
  return card;
}

function draw(card, line, camera) {
  const [state, word] = STATES[camera.state] ?? ["trouble", camera.state];
  put(card.querySelector("h4"), camera.name);
  card.querySelector(".pill").dataset.state = state;
  put(card.querySelector(".pill .text"), t(`camera.${word}`));
  const over = camera.state === "ended";
  card.querySelector("canvas").hidden = card.querySelector(".note").hidden = over;
  if (!over) beltPicture(card.querySelector("canvas"), line, camera.name);
  if (!over) put(card.querySelector(".note"), pictureNote(`${line}/${camera.name}`));
  const scaled = card.querySelector(".scaled");
  scaled.hidden = over || (camera.scaled_percent ?? null) === null;
  put(scaled, scaled.hidden ? "" : t("camera.scaled", { percent: camera.scaled_percent }));
  const values = { n: camera.tubers, rate: number(camera.per_s, 1) };
  put(card.querySelector(".now"), t(camera.state === "ok" && camera.per_s !== null ? "camera.now_rate" : "camera.now", values));
}

export function cameraRows(cameras) {
  return cameras.map((camera) => [
    camera.name, camera.state === "ended" ? "–" : number(camera.per_s, 1), number(camera.processed), number(camera.published),
    camera.age_ms === null ? "–" : `${number(camera.age_ms)} ms`,
    camera.drift_mm === null ? "–" : `${camera.drift_mm > 0 ? "+" : ""}${number(camera.drift_mm, 1)} mm`, lost(camera),
  ]);
}

export function why(kind, reason) {
  return known(`${kind}.${reason}.what`) ? t(`${kind}.${reason}.what`) : reason.replaceAll("_", " ");
}

function lost(camera) {
  const parts = [
    ...(camera.gaps ? [t("gaps", { n: camera.gaps })] : []),
    ...Object.entries(camera.drops).map(([reason, n]) => t("drops", { n, why: why("drop", reason) })),
    ...Object.entries(camera.refused).map(([reason, n]) => t("unreadable", { n, why: reason.replaceAll("_", " ") })),
    ...Object.entries(camera.views_lost).map(([reason, n]) => t("views_lost", { n, why: why("lost", reason) })),
  ];
  return parts.length ? `${parts.join("; ")}.` : t("none_lost");
}

function put(place, text) {
  if (place.textContent !== text) place.textContent = text;
}
