// Lines and bars, drawn by uPlot: the rate of the last ten minutes, and the loads beside each other.
import { apart, chosen, load, loadUnit, number, rate, t } from "./words.js";

const HIGH = 150;
const FONT = "13px system-ui, sans-serif";

// Figures beside an axis, with as many decimals as tell them apart: a bucket is some thousandths of a ton.
export function steps(splits) {
  const step = splits.length > 1 ? splits[1] - splits[0] : splits[0];
  const whole = (digits) => Math.abs(step * 10 ** digits - Math.round(step * 10 ** digits)) < 1e-6;
  return splits.map((figure) => number(figure, [0, 1, 2, 3].find(whole) ?? 4));
}

// A figure that is drawn again where its data, width, light, language or unit is another one.
class Chart {
  constructor(figure) {
    this.figure = figure;
    this.place = figure.querySelector(".plot");
    this.key = "";
    this.plot = null;
    new ResizeObserver(() => this.again?.()).observe(figure);
  }

  draw(caption, said, data, options) {
    this.figure.hidden = false;
    const wide = Math.floor(this.place.clientWidth);
    const colours = Object.fromEntries(["ink", "soft", "rule", "bar", "good"].map((name) => [name, getComputedStyle(this.figure).getPropertyValue(`--${name}`).trim()]));
    const key = JSON.stringify([data, wide, colours, chosen()]);
    if (key === this.key || !wide || !window.uPlot) return;
    this.key = key;
    this.figure.querySelector("figcaption").textContent = caption;
    this.place.setAttribute("aria-label", said);
    this.plot?.destroy();
    const axis = { stroke: colours.soft, font: FONT, grid: { stroke: colours.rule, width: 0.5 }, ticks: { show: false } };
    this.plot = new uPlot({ width: wide, height: HIGH, legend: { show: false }, cursor: { show: false }, padding: [10, 14, 0, 0], ...options(colours, axis, wide) }, data, this.place);
  }
}

export class RateChart extends Chart {
  show(history) {
    this.again = () => this.show(history);
    const figures = (history?.kg_per_min ?? []).map(rate);
    const known = figures.filter((figure) => figure !== null);
    this.figure.hidden = known.length < 2;
    if (this.figure.hidden) return;
    const unit = t(`rate.${chosen().unit}`);
    const digits = Math.max(...known) < 10 ? 1 : 0;
    const at = figures.map((_, n) => (n - figures.length + 1) * history.step_s);
    const most = Math.max(...known);
    const said = most > 0 ? t("rate.said", { low: number(Math.min(...known), digits), high: number(most, digits), now: number(known.at(-1), digits), unit }) : t("rate.none");
    this.draw(t("rate.line", { unit }), said, [at, figures], (colours, axis, wide) => ({
      scales: { x: { time: false }, y: { range: [0, Math.max(1, most * 1.15)] } },
      axes: [
        { ...axis, size: 26, splits: () => (wide < 500 ? [-480, -240, 0] : [-480, -360, -240, -120, 0]), values: (_, splits) => splits.map((s) => (s ? t("span.min", { n: s / 60 }).replace("-", "−") : t("rate.now"))) },
        { ...axis, size: 52, values: (_, splits) => steps(splits) },
      ],
      series: [{}, { stroke: colours.bar, width: 3, fill: `${colours.bar}33`, points: { show: false }, spanGaps: false }],
    }));
  }
}

const MOST_LOADS = 12;

export class LoadsChart extends Chart {
  show(told) {
    this.again = () => this.show(told);
    const loads = told.filter((each) => each.weight_g !== null).slice(0, MOST_LOADS).reverse();
    this.figure.hidden = loads.length < 2;
    if (this.figure.hidden) return;
    const scale = loadUnit(Math.max(...loads.map((each) => each.weight_g)));
    const of = (grams) => (grams === null || grams === undefined ? null : grams / scale.per);
    const data = [loads.map((_, n) => n), loads.map((each) => of(each.weight_g)), loads.map((each) => of(each.low_g)), loads.map((each) => of(each.high_g)), loads.map((each) => of(each.net_g))];
    const most = Math.max(...data.slice(1).flat().map((figure) => figure ?? 0));
    const said = loads.map((each) => `${each.number} ${each.name}: ${load(each.weight_g, scale)} ${scale.unit}`).join("; ");
    this.draw(t("loads.chart", { unit: scale.unit }), said, data, (colours, axis, wide) => ({
      scales: { x: { time: false, range: [-0.6, loads.length - 0.4] }, y: { range: [0, most * 1.12 || 1] } },
      axes: [
        { ...axis, size: 26, grid: { show: false }, splits: () => data[0], values: () => loads.map((each) => name(each, wide / loads.length)) },
        { ...axis, size: 60, values: (_, splits) => steps(splits) },
      ],
      series: [{}, { fill: colours.bar, stroke: colours.bar, paths: uPlot.paths.bars({ size: [0.6, 90] }), points: { show: false } }, ...[2, 3, 4].map(() => ({ show: true, paths: () => null, points: { show: false } }))],
      hooks: { draw: [(plot) => marks(plot, data, colours)] },
    }));
  }
}

// As much of a load's name as its bar has room for.
function name(each, wide) {
  const full = `${each.number}${each.name ? ` ${apart(each.name)}` : ""}`;
  return full.length * 7.5 < wide ? full : String(each.number);
}

function marks(plot, [at, , low, high, scale], colours) {
  const pen = plot.ctx;
  const dots = devicePixelRatio || 1;
  Object.assign(pen, { lineWidth: 2 * dots, strokeStyle: colours.ink, fillStyle: colours.good });
  at.forEach((x, n) => {
    const left = plot.valToPos(x, "x", true);
    if (low[n] !== null) {
      const [top, bottom] = [plot.valToPos(high[n], "y", true), plot.valToPos(low[n], "y", true)];
      pen.beginPath();
      for (const [x0, y0, x1, y1] of [[left, top, left, bottom], [left - 6 * dots, top, left + 6 * dots, top], [left - 6 * dots, bottom, left + 6 * dots, bottom]]) {
        pen.moveTo(x0, y0);
        pen.lineTo(x1, y1);
      }
      pen.stroke();
    }
    if (scale[n] !== null) {
      const y = plot.valToPos(scale[n], "y", true);
      pen.beginPath();
      for (const [dx, dy] of [[0, -7], [7, 0], [0, 7], [-7, 0]]) pen.lineTo(left + dx * dots, y + dy * dots);
      pen.closePath();
      pen.fill();
      pen.stroke();
    }
  });
}
