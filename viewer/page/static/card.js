// One line: its figures, alarms and tables. Texts are set, never parsed as HTML, and only where they changed.
import { cameraCards, cameraRows } from "./cameras.js";
import { histogram } from "./histogram.js";
import { Loads } from "./loads.js";
import { fill } from "./table.js";
import { ago, load, loadUnit, number, when } from "./words.js";

const STALE_S = 3.5;
const STATES = {
  running: ["good", "Running"],
  complete: ["good", "Run complete"],
  waiting: ["wait", "Waiting for the first figures"],
  starting: ["wait", "Looking for the line"],
  trouble: ["trouble", "Running, with trouble"],
  "no contact": ["trouble", "No contact"],
};
const LEVELS = { trouble: "Trouble", warning: "Warning", note: "Note" };

export class LineCard {
  constructor(template) {
    this.element = template.content.firstElementChild.cloneNode(true);
    this.places = Object.fromEntries([...this.element.querySelectorAll("[data-put]")].map((place) => [place.dataset.put, place]));
    const title = this.places.line;
    title.id = `line-${Math.random().toString(36).slice(2)}`;
    this.element.setAttribute("aria-labelledby", title.id);
    this.found = null;
    this.loads = new Loads(this);
  }

  take(found) {
    this.found = found;
    this.put("line", found.line);
    this.alarms(found.alarms ?? []);
    this.load(found.load, found.now);
    this.loads.take(found);
    this.flow(found.flow);
    cameraCards(this.places.cameras, found.line, found.cameras ?? []);
    this.tables(found);
  }

  // How old the figures are now: what the server said, and the time since it said it.
  age(sinceS, lost) {
    const found = this.found;
    if (found === null) return;
    const heardS = found.heard_s === null || found.heard_s === undefined ? null : found.heard_s + (found.told_s ?? 0) + (sinceS ?? 0);
    const final = found.load?.final ?? false;
    const gone = lost || found.state === "no contact" || (!final && heardS !== null && heardS > STALE_S);
    const old = !final && (gone || (found.load?.old ?? false));
    const now = gone && !final && found.state !== "starting" ? "no contact" : found.state;
    const [state, text] = STATES[now] ?? ["wait", found.state];
    this.gone = now === "no contact";
    this.health(found.health);
    this.loads.contact(!this.gone);
    this.places.state.dataset.state = state;
    this.element.dataset.gone = this.gone ? "yes" : "no";
    this.put("state", text, this.places.state.querySelector(".text"));
    this.element.dataset.old = old && found.load ? "yes" : "no";
    this.places.old.hidden = !(old && found.load);
    const loadS = (found.load?.age_s ?? 0) + (found.told_s ?? 0) + (sinceS ?? 0);
    this.put("old", `Old figures: last heard ${ago(Math.max(heardS ?? 0, loadS))} ago`);
  }

  said() {
    return (this.found?.alarms ?? []).filter((alarm) => alarm.level !== "note").map((alarm) => `${this.found.line}: ${alarm.key.replaceAll("-", " ")}`).join(". ");
  }

  alarms(found) {
    const list = this.places.alarms;
    const items = found.length ? found : [{ key: "none", level: "fine", text: "No alarms.", fix: "" }];
    while (list.children.length > items.length) list.lastElementChild.remove();
    items.forEach((alarm, n) => {
      let item = list.children[n];
      if (!item) {
        item = document.createElement("li");
        for (const name of ["level", "text", "fix"]) item.append(Object.assign(document.createElement("span"), { className: name }));
        list.append(item);
      }
      item.dataset.level = alarm.level;
      ["level", "text", "fix"].forEach((name, at) => {
        const text = name === "level" ? LEVELS[alarm.level] ?? "Good" : alarm[name];
        if (item.children[at].textContent !== text) item.children[at].textContent = text;
      });
    });
  }

  load(found, now) {
    this.element.dataset.load = found ? "yes" : "no";
    if (!found) return;
    this.put("run", `run ${found.run}`);
    const { seen_g, estimated_g, coverage, count } = now ?? found;
    this.range("seen", seen_g);
    this.range("estimated", estimated_g);
    const missed = coverage === null ? null : 100 * (1 - coverage);
    const layers = found.layers ? ` And ${found.layers}.` : "";
    this.put("estimated-note", missed === null ? "" : (missed < 0.05 ? "All of the belt was looked at." : `Makes up for the ${number(missed, 1)} % of the belt that no camera saw.`) + layers);
    this.put("count", number(count));
    this.put("coverage", coverage === null ? "–" : `${number(100 * coverage, 1)} %`);
    this.put("mean", count ? `${number(seen_g[1] / count)} g` : "–");
    histogram(this.places.histogram, this.places.classes, found);
  }

  range(name, [low, middle, high]) {
    const scale = loadUnit(middle);
    const output = this.places[name];
    if (!output.firstChild) output.append(document.createElement("b"), document.createElement("span"));
    this.put(name, load(middle, scale), output.firstChild);
    this.put(name, ` ${scale.unit}`, output.lastChild);
    this.put(`${name}-range`, `90 % sure: ${load(low, scale)} to ${load(high, scale)} ${scale.unit}`);
  }

  flow(found) {
    this.put("tubers_per_min", number(found?.tubers_per_min ?? null));
    this.put("kg_per_min", number(found?.kg_per_min ?? null, (found?.kg_per_min ?? 0) < 100 ? 1 : 0));
    const speed = found?.belt_m_per_s ?? null;
    this.put("belt", speed === null ? "–" : Math.abs(speed) < 0.005 ? "stopped" : `${number(speed, 2)} m/s`);
  }

  // One line for who only wants to know whether all is well; the tables are below it.
  health(found) {
    const { processes = 0, well = 0, ended = [], ill = {} } = found ?? {};
    const over = this.found.load?.final && well === 0;
    const parts = [
      `${well} of ${processes} processes work`,
      ...Object.entries(ill).map(([name, state]) => `${name} is ${state}`),
      ...(ended.length ? [`ended: ${ended.join(", ")}`] : []),
    ];
    this.put("health", this.gone ? "Health: not known, there is no contact" : over ? "Health: the run is complete, the line is switched off" : `Health: ${parts.join("; ")}`);
    this.places.health.closest("details").dataset.state = this.gone || over || !processes ? "wait" : Object.keys(ill).length ? "trouble" : "good";
  }

  tables(found) {
    fill(this.places.frames, ["Camera", "Frames a second", "Used", "Taken", "Frame age", "Belt off by", "Lost and left out"], cameraRows(found.cameras ?? []), "No camera yet.");
    fill(this.places.regressors, ["Regressor", "State", "Views a second", "Weighed", "Took", "Refused", "On"], (found.regressors ?? []).map((node) => [
      node.name, node.state, number(node.per_s, 1), number(node.weighed), node.last_ms === null ? "–" : `${number(node.last_ms)} ms`, number(node.refused), node.host,
    ]), "Nobody weighs.");
    fill(this.places.others, ["Process", "State", "On", "Version", "Up"], (found.others ?? []).map((node) => [
      node.name, node.state, node.host, node.version, node.up_s === null ? "–" : ago(node.up_s),
    ]), "None seen.");
    fill(this.places.loads, ["Begun", "Weight as seen", "90 % sure", "Tubers", "Belt looked at", "Run", ""], (found.loads ?? []).map((past) => this.past(past)), "The ledger holds no earlier run.");
  }

  past(past) {
    const scale = loadUnit(past.weight_g);
    return [
      when(past.started_unix_s), past.weight_g === null ? "nothing seen" : `${load(past.weight_g, scale)} ${scale.unit}`,
      past.low_g === null ? "–" : `${load(past.low_g, scale)} to ${load(past.high_g, scale)}`,
      number(past.count), past.coverage === null ? "–" : `${number(100 * past.coverage, 1)} %`, past.run, past.final ? "complete" : "open",
    ];
  }

  put(name, text, place = this.places[name]) {
    if (place.textContent !== text) place.textContent = text;
  }
}
