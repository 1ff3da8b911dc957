// One line: its figures, alarms and tables. Texts are set, never parsed as HTML, and only where they changed.
import { cameraCards, cameraRows } from "./cameras.js";
import { RateChart } from "./charts.js";
import { histogram } from "./histogram.js";
import { Loads } from "./loads.js";
import { FieldMap } from "./map.js";
import { fill } from "./table.js";
import { ago, chosen, empty, load, loadUnit, number, ofTuber, percent, rate, tuberUnit, t, translate, weight, when } from "./words.js";

const STALE_S = 3.5;
const STATES = { running: "good", complete: "good", warned: "warning", waiting: "wait", starting: "wait", stopped: "wait", trouble: "trouble", "no contact": "trouble" };
const RUN_ENDS = { stopped: "stopped", "cut off": "cut_off" };

export class LineCard {
  constructor(template) {
    this.element = template.content.firstElementChild.cloneNode(true);
    this.places = Object.fromEntries([...this.element.querySelectorAll("[data-put]")].map((place) => [place.dataset.put, place]));
    const title = this.places.line;
    title.id = `line-${Math.random().toString(36).slice(2)}`;
    this.element.setAttribute("aria-labelledby", title.id);
    translate(this.element);
    this.found = null;
    this.loads = new Loads(this);
    this.rate = new RateChart(this.places.rate);
    this.field = new FieldMap(this.places.field);
  }

  // In another language or unit.
  again() {
    translate(this.element);
    if (this.found) this.take(this.found);
  }

  take(found) {
    this.found = found;
    this.put("line", found.line);
    this.alarms(found.alarms ?? []);
    this.load(found.load, found.now);
    this.loads.take(found);
    this.field.take(found.line, found.map ?? 0);
    this.flow(found.flow, found.rate);
    cameraCards(this.places.cameras, found.line, found.cameras ?? []);
    this.tables(found);
  }

  // How old the figures are now: what the server said, and the time since it said it.
  age(sinceS, lost) {
    const found = this.found;
    if (found === null) return;
    const heardS = found.heard_s === null || found.heard_s === undefined ? null : found.heard_s + (found.told_s ?? 0) + (sinceS ?? 0);
    const final = found.load?.final ?? false;
    const over = final || found.state === "stopped"; // figures that no one adds to do not grow old
    const gone = lost || found.state === "no contact" || (!over && heardS !== null && heardS > STALE_S);
    const old = !over && (gone || (found.load?.old ?? false));
    const now = gone && !over && found.state !== "starting" ? "no contact" : found.state;
    this.gone = now === "no contact";
    this.health(found.health);
    this.loads.contact(!lost && heardS !== null && heardS <= STALE_S); // a line that is off hears no order
    this.places.state.dataset.state = STATES[now] ?? "wait";
    this.element.dataset.gone = this.gone ? "yes" : "no";
    this.put("state", t(`state.${now.replace(" ", "_")}`), this.places.state.querySelector(".text"));
    this.element.dataset.old = old && found.load ? "yes" : "no";
    this.places.old.hidden = !(old && found.load);
    const loadS = (found.load?.age_s ?? 0) + (found.told_s ?? 0) + (sinceS ?? 0);
    this.put("old", t("old", { for: Math.max(heardS ?? 0, loadS) }));
  }

  // Without durations, which would be read out every second.
  said() {
    return (this.found?.alarms ?? []).filter((alarm) => alarm.level !== "note").map((alarm) => `${this.found.line}: ${t(alarm.say, { ...alarm.values, for: "…" })}`).join(" ");
  }

  alarms(found) {
    const list = this.places.alarms;
    this.element.dataset.worst = found[0]?.level ?? "fine"; // the worst comes first
    const items = found.length ? found : [{ level: "fine", say: "alarms.none", todo: "" }];
    while (list.children.length > items.length) list.lastElementChild.remove();
    items.forEach(({ level, say, todo, values }, n) => {
      let item = list.children[n];
      if (!item) {
        item = document.createElement("li");
        for (const name of ["level", "text", "fix"]) item.append(Object.assign(document.createElement("span"), { className: name }));
        list.append(item);
      }
      item.dataset.level = level;
      [t(`level.${level}`), t(say, values), todo ? t(todo, values) : ""].forEach((text, at) => this.put("alarms", text, item.children[at]));
    });
  }

  load(found, now) {
    this.element.dataset.load = found ? "yes" : "no";
    if (!found) return;
    this.put("run", t("run", { run: found.run }));
    const { seen_g, estimated_g, coverage, count, calibrated } = now ?? found;
    const ofRun = !now && (this.found.told ?? []).length > 0; // between loads the figures are the run's
    this.put("seen-name", t(ofRun ? "run.seen" : "load.seen"));
    this.put("estimated-name", t(ofRun ? "run.estimated" : "load.estimated"));
    this.range("seen", seen_g, count);
    this.range("estimated", estimated_g, count);
    const missed = coverage === null ? null : 100 * (1 - coverage);
    const seen = missed === null ? "" : missed < 0.05 ? t("load.all_seen") : t("load.made_up", { percent: missed });
    this.put("estimated-note", [seen, found.layers?.where ? t("load.layers", found.layers) : ""].filter(Boolean).join(" "));
    this.put("calibrated", t(calibrated ? "calibrated.yes" : "calibrated.no"));
    this.put("count", number(count));
    this.put("coverage", percent(coverage));
    this.put("mean", count ? `${ofTuber(seen_g[1] / count)} ${tuberUnit().unit}` : "–");
    histogram(this.places.histogram, this.places.classes, found);
  }

  range(name, [low, middle, high], count) {
    const scale = loadUnit(middle);
    const output = this.places[name];
    if (!output.firstChild) output.append(document.createElement("b"), document.createElement("span"));
    this.put(name, load(middle, scale), output.firstChild);
    this.put(name, ` ${scale.unit}`, output.lastChild);
    this.put(`${name}-range`, empty({ count, weight_g: middle }) ? t("histogram.none") : t("load.sure", { low: load(low, scale), high: load(high, scale), unit: scale.unit }));
  }

  flow(found, history) {
    const now = rate(found?.kg_per_min ?? null);
    this.put("tubers_per_min", number(found?.tubers_per_min ?? null));
    this.put("rate-unit", t(`rate.${chosen().unit}`));
    this.put("kg_per_min", number(now, (now ?? 0) < 100 ? 1 : 0));
    const speed = found?.belt_m_per_s ?? null;
    this.put("belt", speed === null ? "–" : Math.abs(speed) < 0.005 ? t("belt_stopped") : `${number(speed, 2)} m/s`);
    this.rate.show(history);
  }

  // One line for who only wants to know whether all is well; the tables are below it.
  health(found) {
    const { processes = 0, well = 0, ended = [], ill = {} } = found ?? {};
    const stopped = this.found.state === "stopped";
    const over = stopped || (this.found.load?.final && well === 0);
    const parts = [
      t("health.well", { well, all: processes }),
      ...Object.entries(ill).map(([name, state]) => t("health.ill", { name, state: t(`node.${state}`) })),
      ...(ended.length ? [t("health.ended", { names: ended.join(", ") })] : []),
    ];
    this.put("health", t("health", { what: this.gone ? t("health.unknown") : over ? t(stopped ? "health.stopped" : "health.over") : parts.join("; ") }));
    this.places.health.closest("details").dataset.state = this.gone || over || !processes ? "wait" : Object.keys(ill).length ? "trouble" : "good";
  }

  tables(found) {
    const heads = (...keys) => keys.map((key) => (key ? t(key) : ""));
    const state = (node) => ({ text: t(`node.${node.state}`), state: node.state });
    fill(this.places.frames, heads("col.camera", "col.per_s", "col.used", "col.taken", "col.age", "col.drift", "col.lost"), cameraRows(found.cameras ?? []), t("cameras.none"));
    fill(this.places.regressors, heads("col.regressor", "col.state", "col.views_per_s", "col.weighed", "col.took", "col.refused", "col.on"), (found.regressors ?? []).map((node) => [
      node.name, state(node), number(node.per_s, 1), number(node.weighed), node.last_ms === null ? "–" : `${number(node.last_ms)} ms`, number(node.refused), node.host,
    ]), t("weighing.none"));
    fill(this.places.others, heads("col.process", "col.state", "col.on", "col.version", "col.up"), (found.others ?? []).map((node) => [
      node.name, state(node), node.host, node.version, node.up_s === null ? "–" : ago(node.up_s),
    ]), t("others.none"));
    fill(this.places.loads, heads("begun", "weight_seen", "sure", "tubers", "belt_seen", "run_name", ""), (found.loads ?? []).map((past) => this.past(past)), t("runs.none"));
  }

  past(past) {
    const scale = loadUnit(past.weight_g);
    return [
      when(past.started_unix_s), past.weight_g === null ? t("nothing_seen") : weight(past.weight_g),
      past.low_g === null || empty(past) ? "–" : t("range", { low: load(past.low_g, scale), high: load(past.high_g, scale) }),
      number(past.count), percent(past.coverage), past.run, t(`run.${past.final ? "complete" : RUN_ENDS[past.end] ?? "open"}`),
    ];
  }

  put(name, text, place = this.places[name]) {
    if (place.textContent !== text) place.textContent = text;
  }
}
