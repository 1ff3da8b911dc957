// Bars of tubers per weight class over an axis of round figures; the same as a table for who cannot see bars.
import { fill } from "./table.js";
import { chosen, number, ofTuber, tuberUnit, t } from "./words.js";

const SVG = "http://www.w3.org/2000/svg";
const HIGH = 220, LEFT = 62, RIGHT = 24, BOTTOM = 50, TOP = 24;
const WIDE_UNSEEN = 600; // a picture that is not laid out yet has no width
const OUNCES = [1, 2, 4, 8, 16, 32]; // steps of the axis; of grams they are those of the classes
const drawn = new WeakMap(); // what each picture shows already

export function histogram(svg, table, load) {
  const counts = load.histogram;
  const wide = svg.clientWidth || WIDE_UNSEEN; // one unit is one pixel: words keep their size on a phone
  const key = JSON.stringify([counts, load.step_g, wide, chosen()]);
  if (drawn.get(svg) === key) return;
  drawn.set(svg, key);
  svg.setAttribute("viewBox", `0 0 ${wide} ${HIGH}`);
  svg.replaceChildren();
  const last = Math.max(7, counts.length - 1);
  const most = Math.max(1, ...counts);
  const step = (wide - LEFT - RIGHT) / (last + 1);
  const floor = HIGH - BOTTOM;
  for (const share of [0.5, 1]) {
    const y = floor - share * (floor - TOP);
    add(svg, "line", { x1: LEFT, x2: wide - RIGHT, y1: y, y2: y, class: "grid" });
    if (share * most === Math.round(share * most)) text(svg, LEFT - 6, y + 6, number(share * most), "end");
  }
  counts.forEach((n, at) => {
    const high = (n / most) * (floor - TOP);
    if (n) add(svg, "rect", { x: LEFT + at * step + 1.5, y: floor - high, width: Math.max(1, step - 3), height: high, class: "bar" });
  });
  add(svg, "line", { x1: LEFT, x2: wide - RIGHT, y1: floor, y2: floor, class: "axis" });
  const { unit, per } = tuberUnit();
  const end = ((last + 1) * load.step_g) / per; // of the axis, in its unit
  const every = figures(end / Math.min(8, wide / 60), load.step_g / per);
  for (let at = 0; at <= end + 1e-6; at += every) text(svg, LEFT + (at / end) * (wide - LEFT - RIGHT), floor + 20, number(at), "middle");
  text(svg, wide - RIGHT, HIGH - 8, t(`histogram.axis.${unit}`), "end");
  svg.setAttribute("aria-label", summary(counts, load.step_g));
  fill(table, [t(`histogram.unit.${unit}`), t("tubers")], counts.map((n, at) => [classOf(at, load.step_g), number(n)]).filter(([, n]) => n !== "0"), t("histogram.none"));
}

// From one figure of the axis to the next: `least` or more.
function figures(least, ofClass) {
  if (tuberUnit().unit === "oz") return OUNCES.find((step) => step >= least) ?? 32 * Math.ceil(least / 32);
  return ofClass * Math.ceil(least / ofClass);
}

function summary(counts, step_g) {
  const most = Math.max(0, ...counts);
  const at = counts.indexOf(most);
  return most ? t(`histogram.most.${tuberUnit().unit}`, { n: most, low: ofTuber(at * step_g), high: ofTuber((at + 1) * step_g) }) : t("histogram.none");
}

function classOf(at, step_g) {
  return t("range", { low: ofTuber(at * step_g), high: ofTuber((at + 1) * step_g) });
}

function add(svg, name, attributes) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  svg.append(element);
  return element;
}

function text(svg, x, y, words, anchor) {
  add(svg, "text", { x, y, "text-anchor": anchor }).textContent = words;
}
