// The load that is open, the run below it, what the contract's classes hold, the ledger's loads, and who may act.
import { ask } from "./act.js";
import { fill } from "./table.js";
import { load, loadUnit, number, when } from "./words.js";

const UNDO_WITHIN_S = 60;
const LIMITS = { "": "", kept: "✓ kept", open: "? open", broken: "✕ broken" };
const SAID_MS = 60000;

export class Loads {
  constructor(card) {
    this.card = card;
    for (const button of card.element.querySelectorAll("[data-act]")) {
      button.addEventListener("click", () => ask(card.found.line, button.dataset.act, card.found, (text) => this.said(text)));
    }
  }

  // What stands in large figures: the open load, or the run where none is.
  take(found) {
    const { now, told = [] } = found;
    const put = (name, text) => this.card.put(name, text);
    const none = !found.load ? "No figures yet" : told.length ? "No load is open" : "No load was started";
    put("which", now ? [`Load ${now.number}`, now.name].filter(Boolean).join(" · ") : none);
    put("known", now ? [`since ${when(now.since_unix_s)}`, ...now.known].join(" · ") : !found.load ? "" : told.length ? "What comes now belongs to no load. These are the figures of the whole run." : "The whole run counts as one load.");
    this.below(now ? found.load : null);
    this.matter(now ?? found.load, found.contract);
    fill(this.card.places.told, ["Load", "Begun", "Weight", "90 % sure", "Tubers", "Belt looked at", "Scale", "Field", "Variety"], told.map((each) => this.row(each)), "No load was started yet.");
    this.buttons(found, now);
  }

  below(run) {
    this.card.places.below.hidden = !run;
    if (!run) return;
    const scale = loadUnit(run.seen_g[1]);
    this.card.put("below", `The whole run: ${load(run.seen_g[1], scale)} ${scale.unit} (90 % sure: ${load(run.seen_g[0], scale)} to ${load(run.seen_g[2], scale)} ${scale.unit}), ${number(run.count)} tubers, ${run.coverage === null ? "–" : `${number(100 * run.coverage, 1)} %`} of the belt looked at`);
  }

  matter(figures, contract) {
    const { foreign, matter } = this.card.places;
    const shares = figures?.foreign_percent ?? null;
    foreign.parentElement.hidden = shares === null;
    if (shares) this.card.put("foreign", `${number(shares[1], 1)} %`);
    if (shares) this.card.put("foreign-range", `${number(shares[0], 1)} to ${number(shares[2], 1)} % of the weight`);
    const classes = figures?.classes ?? [];
    matter.hidden = classes.length === 0;
    this.card.put("contract", `Classes of the contract${contract ? `: ${contract}` : ""}`);
    fill(this.card.places.sizes, ["Class", "Share", "90 % sure", "kg", "Limits"], classes.map((each) => [
      each.name, `${number(each.percent, 1)} %`, `${number(each.percent_low, 1)} to ${number(each.percent_high, 1)} %`, number(each.weight_g / 1000, each.weight_g < 1e5 ? 1 : 0), LIMITS[each.state] ?? each.state,
    ]), "");
  }

  row(each) {
    const scale = loadUnit(each.weight_g);
    const scales = [each.net_g === null ? "" : `${number(each.net_g / 1000, 1)} kg`, each.gross_g === null ? "" : `${number(each.gross_g / 1000, 1)} kg gross`].filter(Boolean).join(", ");
    return [
      `${each.number}${each.name ? ` · ${each.name}` : ""}${each.open ? " (open)" : ""}`, when(each.began_unix_s),
      each.weight_g === null ? "–" : `${load(each.weight_g, scale)} ${scale.unit}`,
      each.low_g === null ? "–" : `${load(each.low_g, scale)} to ${load(each.high_g, scale)}`,
      number(each.count), each.coverage === null ? "–" : `${number(100 * each.coverage, 1)} %`,
      (scales && each.refused.length ? `${scales}: ${each.refused.join("; ")}` : scales) || "–", each.field || "–", each.variety || "–",
    ];
  }

  buttons(found, now) {
    const { acts, only } = this.card.places;
    acts.hidden = Boolean(found.looks_only) || !("looks_only" in found);
    only.hidden = !found.looks_only;
    this.card.put("only", `Loads cannot be changed from this page: ${found.looks_only}`);
    const shown = { start: true, end: Boolean(now), undo: this.undoable(found), ticket: (found.told ?? []).length > 0 };
    for (const button of acts.querySelectorAll("[data-act]")) button.hidden = !shown[button.dataset.act];
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
