// Light, language and unit: chosen in one small menu and remembered on this device alone.
import { LANGUAGES, UNITS, choose, chosen, remember, remembered, t, translate } from "./words.js";

const LIGHTS = ["auto", "day", "night"];
const menu = document.getElementById("menu");

export function openMenu(changed) {
  let light = LIGHTS.includes(remembered("light")) ? remembered("light") : "auto";
  document.documentElement.dataset.light = light;
  const options = () => {
    fill("light", LIGHTS.map((name) => [name, t(`menu.${name}`)]), light);
    fill("language", Object.entries(LANGUAGES), chosen().language);
    fill("unit", UNITS.map((unit) => [unit, unit]), chosen().unit);
    translate(document);
  };
  for (const name of ["light", "language", "unit"]) {
    document.getElementById(name).addEventListener("change", (event) => {
      if (name === "light") remember("light", (document.documentElement.dataset.light = light = event.target.value));
      else choose(name, event.target.value);
      options();
      changed();
    });
  }
  document.addEventListener("click", (event) => { if (menu.open && !menu.contains(event.target)) menu.open = false; });
  menu.addEventListener("focusout", (event) => { if (event.relatedTarget && !menu.contains(event.relatedTarget)) menu.open = false; });
  document.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || !menu.open) return;
    if (menu.contains(document.activeElement)) menu.querySelector("summary").focus(); // not lost with what is hidden now
    menu.open = false;
  });
  options();
}

function fill(name, pairs, value) {
  const select = document.getElementById(name);
  select.replaceChildren(...pairs.map(([key, text]) => new Option(text, key)));
  select.value = value;
}
