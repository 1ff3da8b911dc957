// Words, numbers and weights as a person reads them: in their language, and in the unit that they chose.
const TABLE = await (await fetch("words.json")).json();
export const LANGUAGES = { en: "English", de: "Deutsch", nl: "Nederlands", ja: "日本語" };
export const UNITS = ["kg", "t", "lb"];
const GRAMS = { kg: 1e3, t: 1e6, lb: 453.59237 };
const COMMA = new Set(["de", "nl"]);
const BEFORE_UNIT = /(\d) (?=(?:%|[smhgtu]|min|mm|ms|kg|lb|oz|days|Tagen|dagen)(?!\p{L}))/gu;
const VALUE = /\{(\w+)(?::([^}]+))?\}/g;
let language = firstOf(new URLSearchParams(location.search).get("lang"), remembered("language"), ...(navigator.languages ?? [])) ?? "en";
let unit = UNITS.includes(remembered("unit")) ? remembered("unit") : "kg";
document.documentElement.lang = language;

// Of the languages that are asked for, the first one that the table has: 'de-AT' is 'de'.
function firstOf(...asked) {
  return asked.map((tag) => (tag ?? "").toLowerCase().split(/[-_]/)[0]).find((tag) => tag in LANGUAGES);
}

export const chosen = () => ({ language, unit });

export function choose(name, value) {
  remember(name, value);
  if (name === "language") document.documentElement.lang = language = value;
  if (name === "unit") unit = value;
}

export function remembered(name) {
  try {
    return localStorage.getItem(name);
  } catch {
    return null; // storage is switched off
  }
}

export function remember(name, value) {
  try {
    localStorage.setItem(name, value);
  } catch {
    // kept until the page is closed
  }
}

// The text `key`; `values` fill its {places}. A key without words is shown by its own last part.
export function t(key, values = {}) {
  const text = TABLE[key]?.[language] ?? key.split(".").pop().replaceAll("_", " ");
  // A figure and its unit stay on one line.
  return text.replace(VALUE, (_, name, how) => told(values[name] ?? "", how)).replace(BEFORE_UNIT, "$1\u00a0");
}

export const known = (key) => key in TABLE;

function told(value, how) {
  if (how === undefined || typeof value !== "number") return typeof value === "number" ? number(value) : String(value);
  if (how === "span") return ago(value);
  return `${how.startsWith("+") && value >= 0 ? "+" : ""}${number(value, Number(how.replace("+", "")))}`;
}

export function ago(seconds) {
  const whole = Math.max(0, Math.floor(seconds));
  if (whole < 120) return t("span.s", { n: whole });
  if (whole < 7200) return t("span.min", { n: Math.floor(whole / 60) });
  if (whole < 172800) return t("span.h", { h: Math.floor(whole / 3600), m: Math.floor((whole % 3600) / 60) });
  return t("span.days", { n: Math.floor(whole / 86400) });
}

export function number(value, digits = 0) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  // Thin spaces between thousands, which do not break: neither comma nor point, which differ between countries.
  const [whole, rest] = Math.abs(value).toFixed(digits).split(".");
  const grouped = whole.replace(/\B(?=(\d{3})+(?!\d))/g, "\u202f");
  return (value < 0 ? "−" : "") + grouped + (rest ? `${COMMA.has(language) ? "," : "."}${rest}` : "");
}

export const percent = (share, digits = 1) => (share === null || share === undefined ? "–" : `${number(100 * share, digits)} %`);

// A load: one unit and one number of decimals for a figure and the interval around it.
export function loadUnit(grams) {
  const figure = Math.abs(grams ?? 0) / GRAMS[unit];
  return { unit, per: GRAMS[unit], digits: unit === "t" ? (figure < 10 ? 3 : 2) : figure < 100 ? 2 : figure < 1000 ? 1 : 0 };
}

export function load(grams, scale) {
  return grams === null || grams === undefined ? "–" : number(grams / scale.per, scale.digits);
}

// Nothing was counted of it: zero is no weight that an interval belongs to.
export const empty = ({ count, weight_g }) => !count && !weight_g;

// "206.4 kg"
export function weight(grams) {
  const scale = loadUnit(grams);
  return grams === null || grams === undefined ? "–" : `${load(grams, scale)} ${scale.unit}`;
}

// What a scale said, to the last figure that it shows.
export function scaled(grams) {
  return `${number(grams / GRAMS[unit], unit === "t" ? 4 : 1)} ${unit}`;
}

const SAID_KG = /(?<![\w.])(\d+(?:\.\d+)?(?:e[+-]?\d+)?) kg\b/.source;

// What a line said, which says kilograms, in the unit that was chosen; `names` of loads stay as persons gave them.
export function inUnit(said, names = []) {
  if (unit === "kg" || !said) return said;
  const kept = names.filter(Boolean).map((name) => name.replace(/[\\^$.*+?()[\]{}|]/g, "\\$&")).sort((a, b) => b.length - a.length);
  return said.replace(new RegExp([...kept, SAID_KG].join("|"), "g"), (found, kg) => (kg === undefined ? found : scaled(1000 * Number(kg))));
}

// What a hectare gives; an acre where loads are told in pounds.
export const yieldUnit = () => (unit === "lb" ? { unit: "lb/acre", per: (GRAMS.lb * 2.4710538) / 1e6, digits: 0 } : { unit: "t/ha", per: 1, digits: 1 });

// One tuber, whose weight no one says in kilograms: grams, and ounces where loads are told in pounds.
export const tuberUnit = () => (unit === "lb" ? { unit: "oz", per: GRAMS.lb / 16, digits: 1 } : { unit: "g", per: 1, digits: 0 });

// "172", or "6.1" of ounces
export const ofTuber = (grams) => number(grams / tuberUnit().per, tuberUnit().digits);

const OTHER_WAY = /[\u0590-\u08ff\u200e\u200f\u202a-\u202e\u2066-\u2069\ufb1d-\ufdff\ufe70-\ufeff]/;
const TURNS = /[\u202a-\u202e\u2066-\u2069]/g;

// What a person gave as a name, among other words: where it reads from right to left it turns none of them around.
export const apart = (name) => (OTHER_WAY.test(name) ? `\u2068${name.replace(TURNS, "")}\u2069` : name);

// What comes in a minute, or in an hour for who counts in tons.
export function rate(kgPerMin) {
  if (kgPerMin === null || kgPerMin === undefined) return null;
  return unit === "t" ? (kgPerMin * 60) / 1000 : (kgPerMin * 1000) / GRAMS[unit];
}

export const inKilograms = (figure) => (figure * GRAMS[unit]) / 1000;

// By this device's clock, with its zone: the line may stand in another one.
export function when(unixS) {
  const at = new Date(unixS * 1000);
  return `${at.toLocaleString(language, { dateStyle: "short", timeStyle: "short" })} ${zone(-at.getTimezoneOffset())}`;
}

// "UTC", "UTC+2", "UTC-3:30"
function zone(minutes) {
  const [hours, rest] = [Math.floor(Math.abs(minutes) / 60), Math.abs(minutes) % 60];
  return minutes ? `UTC${minutes < 0 ? "-" : "+"}${hours}${rest ? `:${String(rest).padStart(2, "0")}` : ""}` : "UTC";
}

// Texts that stand in the page itself.
export function translate(place) {
  for (const each of place.querySelectorAll("[data-word]")) each.textContent = t(each.dataset.word, { unit: tuberUnit().unit });
  for (const each of place.querySelectorAll("[data-label]")) each.setAttribute("aria-label", t(each.dataset.label));
  for (const each of place.querySelectorAll("[data-example]")) each.placeholder = t(each.dataset.example);
}
