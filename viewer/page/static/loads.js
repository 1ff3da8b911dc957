// The load that is open, the run below it, what the contract's classes hold, the ledger's loads, and who may act.
import { ask } from "./act.js";
import { LoadsChart } from "./charts.js";
import { fill } from "./table.js";
import { apart, empty, inUnit, load, loadUnit, number, percent, scaled, t, weight, when } from "./words.js";

const UNDO_WITHIN_S = 60;
const SAID_MS = 60000;
const MOST_TOLD = 24; // loads; the server tells no more

// "packer 2026, by square mesh": a contract's own name, and by what it measures in the reader's language.
function contractNamed(told) {
  const [, name, measure] = /^(?:(.*), )?by (square mesh|length)$/.exec(told) ?? [null, told, ""];
  return [name, measure && t(measure === "length" ? "measure.length" : "measure.mesh")].filter(Boolean).join(", ");
}

export class Loads {
  constructor(card) {
    this.card = card;
    this.chart = new LoadsChart(card.places.compare);
    for (const button of card.element.querySelectorAll("[data-act]")) {
      button.addEventListener("click", () => ask(card.found.line, button.dataset.act, card.found, (text) => this.said(text)));
    }
  }

  // What stands in large figures: the open load, or the run where none is.
  take(found) {
    const { now, told = [] } = found;
    const put = (name, text) => this.card.put(name, text);
    const none = !found.load ? "load.no_figures" : told.length ? "load.none_open" : "load.none_started";
    put("which", now ? [t("load.number", { n: now.number }), apart(now.name)].filter(Boolean).join(" · ") : t(none));
    const below = !found.load ? "" : told.length ? `${this.last(told[0])} ${t("load.belongs_to_none")}`.trim() : t("load.whole_run");
    put("known", now ? [t("load.since", { when: when(now.since_unix_s) }), ...now.known.map(apart)].join(" · ") : below);
    this.below(now ? found.load : null);
    this.matter(now ?? found.load, found.contract);
    const heads = ["load", "begun", "weight", "sure", "tubers", "belt_seen", "scale", "field", "variety", "notes"];
    fill(this.card.places.told, heads.map((key) => t(key)), told.map((each) => this.row(each, told.map(({ name }) => name))), t("loads.none"));
    this.chart.show(told);
    const older = told.length >= MOST_TOLD ? told.at(-1).number - 1 : 0;
    this.card.places.older.hidden = !older;
    put("older", older ? t("loads.older", { n: older }) : "");
    this.buttons(found, now);
  }

  // What the load that ended last weighs.
  last({ number: n, count, weight_g, low_g, high_g }) {
    if (weight_g === null || empty({ count, weight_g })) return "";
    const scale = loadUnit(weight_g);
    return t("load.last", { n, weight: load(weight_g, scale), low: load(low_g, scale), high: load(high_g, scale), unit: scale.unit });
  }

  below(run) {
    this.card.places.below.hidden = !run;
    if (!run) return;
    const scale = loadUnit(run.seen_g[1]);
    const [low, middle, high] = run.seen_g.map((grams) => load(grams, scale));
    this.card.put("below", t("below", { weight: middle, low, high, unit: scale.unit, count: run.count, coverage: percent(run.coverage) }));
  }

  matter(figures, contract) {
    const { foreign, matter } = this.card.places;
    const shares = figures?.foreign_percent ?? null;
    foreign.parentElement.hidden = shares === null;
    if (shares) this.card.put("foreign", `${number(shares[1], 1)} %`);
    if (shares) this.card.put("foreign-range", t("foreign.range", { low: shares[0], high: shares[2] }));
    const classes = figures?.classes ?? [];
    matter.hidden = classes.length === 0;
    this.card.put("contract", contract ? t("classes.of", { name: contractNamed(contract) }) : t("classes"));
    const { unit } = loadUnit(classes[0]?.weight_g);
    const limits = classes.some((each) => each.state);
    fill(this.card.places.sizes, [t("class"), t("share"), t("sure"), unit, ...(limits ? [t("limits")] : [])], classes.map((each) => [
      each.name, `${number(each.percent, 1)} %`, `${t("range", { low: number(each.percent_low, 1), high: number(each.percent_high, 1) })} %`,
      load(each.weight_g, loadUnit(each.weight_g)), ...(limits ? [each.state ? t(`limit.${each.state}`) : "–"] : []),
    ]), "");
  }

  row(each, names) {
    const scale = loadUnit(each.weight_g);
    const scales = [each.net_g === null ? "" : scaled(each.net_g), each.gross_g === null ? "" : t("gross", { weight: scaled(each.gross_g) })].filter(Boolean).join(", ");
    const against = inUnit([...each.refused, ...(each.doubts ?? [])].join("; "), names);
    return [
      [each.number, each.name && `· ${apart(each.name)}`, each.open && t("open_load")].filter(Boolean).join(" "), when(each.began_unix_s), weight(each.weight_g),
      each.low_g === null || empty(each) ? "–" : t("range", { low: load(each.low_g, scale), high: load(each.high_g, scale) }),
      number(each.count), percent(each.coverage),
      (scales && against ? `${scales}: ${against}` : scales) || "–", apart(each.field) || "–", apart(each.variety) || "–",
      (each.notes ?? []).map(({ text, by }) => (by ? `${apart(text)} (${apart(by.replace(/^page: /, ""))})` : apart(text))).join("; ") || "–",
    ];
  }

  buttons(found, now) {
    const { acts, only } = this.card.places;
    acts.hidden = Boolean(found.looks_only) || !("looks_only" in found);
    only.hidden = !found.looks_only;
    this.card.put("only", t("only_looks", { why: found.looks_only ?? "" }));
    const told = (found.told ?? []).length > 0;
    const shown = { start: true, end: Boolean(now), undo: this.undoable(found), ticket: told, note: told };
    for (const button of acts.querySelectorAll("[data-act]")) {
      const focused = button === document.activeElement;
      button.hidden = !shown[button.dataset.act];
      if (focused && button.hidden) acts.querySelector("[data-act=start]").focus(); // who goes by keys stays here
    }
  }

  // An order needs a line that hears it.
  contact(there) {
    for (const button of this.card.places.acts.children) button.disabled = !there;
  }

  undoable(found) {
    return found.changed_s !== null && found.changed_s !== undefined && found.changed_s < UNDO_WITHIN_S;
  }

  said(text) {
    this.card.put("said", text);
    clearTimeout(this.quiet);
    this.quiet = setTimeout(() => this.card.put("said", ""), SAID_MS);
  }
}
