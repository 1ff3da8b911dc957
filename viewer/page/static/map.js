// The field as it fills: cells by their yield and the machine's way, drawn by maplibre-gl without any tiles.
import { number, t, yieldUnit } from "./words.js";

const COLOURS = ["#ffffcc", "#c2e699", "#78c679", "#31a354", "#006837"];
const EMPTY = { type: "FeatureCollection", features: [] };
let library = null;

// A megabyte that is fetched only where there is a field to be shown.
function maplibre() {
  library ??= new Promise((resolve, reject) => {
    const script = Object.assign(document.createElement("script"), { src: "shipped/maplibre-gl.min.js" });
    script.onerror = () => { library = null; script.remove(); reject(new Error("not fetched")); };
    script.onload = () => {
      window.maplibregl.setWorkerUrl(new URL("shipped/maplibre-gl.worker.js", document.baseURI).href);
      resolve(window.maplibregl);
    };
    document.head.append(script);
  });
  return library;
}

export class FieldMap {
  constructor(section) {
    this.section = section;
    this.place = section.querySelector(".map");
    this.number = 0;
    this.found = null;
    this.begun = null; // of the map, which takes its time
    this.undrawn = false; // this browser cannot
  }

  async take(line, number_) {
    if (number_ === this.number) return this.tell();
    this.number = number_;
    if (!number_) return;
    let found;
    try {
      found = await (await fetch(`map.json?line=${encodeURIComponent(line)}`)).json();
      const empty = !found.cells.features.length && found.way.length < 2; // a run that has just begun
      const silent = empty && !reason(found);
      this.found = silent ? null : found;
      this.section.hidden = silent;
      this.place.hidden = empty;
      if (empty) return this.tell();
      await maplibre();
    } catch {
      this.number = null; // the server did not answer: asked again with the next snapshot
      return;
    }
    try {
      this.tell();
      this.begun ??= this.begin(found);
      this.map = await this.begun;
      this.fill(found);
    } catch {
      this.undrawn = true;
      this.tell();
    }
  }

  tell() {
    if (!this.found) return;
    const { about, cells, way } = this.found;
    const { unit, per, digits } = yieldUnit();
    const [low, high, mean] = [about.low, about.high, about.mean].map((figure) => number(figure === null || figure === undefined ? null : figure / per, digits));
    const known = cells.features.length > 0;
    this.section.querySelector(".colours").hidden = !known;
    const drawn = way.length < 2 ? "" : t(this.undrawn ? "map.no_webgl" : "map.way");
    const told = known ? t(this.undrawn ? "map.no_webgl" : "map.legend", { low, high, mean, unit }) : [drawn, reason(this.found)].filter(Boolean).join(" ");
    this.section.querySelector(".told").textContent = told;
    this.place.setAttribute("aria-label", known && !this.undrawn ? t("map.said", { n: cells.features.length, mean, unit }) : told);
  }

  async begin(found) {
    const { Map: Maplibre } = await maplibre();
    const sources = Object.fromEntries(["cells", "way", "here"].map((name) => [name, { type: "geojson", data: EMPTY }]));
    const layers = [
      { id: "cells", source: "cells", type: "fill", paint: { "fill-color": COLOURS[2], "fill-outline-color": "#5a6152" } },
      { id: "way", source: "way", type: "line", paint: { "line-color": "#1d4fb8", "line-width": 2, "line-opacity": 0.75 } },
      { id: "here", source: "here", type: "circle", paint: { "circle-radius": 7, "circle-color": "#d11f2f", "circle-stroke-color": "#ffffff", "circle-stroke-width": 2 } },
    ];
    const map = new Maplibre({ container: this.place, style: { version: 8, sources, layers }, interactive: false, attributionControl: false, fadeDuration: 0, maxZoom: 21, center: first(found), zoom: 16 });
    await new Promise((resolve) => map.once("load", resolve));
    map.on("idle", () => { this.place.dataset.cells = map.queryRenderedFeatures({ layers: ["cells"] }).length; });
    return map;
  }

  fill(found) {
    const { cells, way, about } = inOnePiece(found);
    const [low, high] = [about.low ?? 0, Math.max(about.high ?? 1, (about.low ?? 0) + 0.1)];
    const steps = COLOURS.flatMap((colour, n) => [low + ((high - low) * n) / (COLOURS.length - 1), colour]);
    this.map.setPaintProperty("cells", "fill-color", ["interpolate", ["linear"], ["get", "t_ha"], ...steps]);
    this.map.getSource("cells").setData(cells);
    this.map.getSource("way").setData({ type: "Feature", properties: {}, geometry: { type: "LineString", coordinates: way } });
    this.map.getSource("here").setData(way.length ? { type: "Feature", properties: {}, geometry: { type: "Point", coordinates: way.at(-1) } } : EMPTY);
    const places = [...way, ...cells.features.flatMap((cell) => cell.geometry.coordinates[0])];
    const [lons, lats] = [0, 1].map((at) => places.map((place) => place[at]));
    const least = (values) => values.reduce((a, b) => Math.min(a, b));
    const most = (values) => values.reduce((a, b) => Math.max(a, b));
    this.map.fitBounds([[least(lons), least(lats)], [most(lons), most(lats)]], { padding: 24, animate: false, maxZoom: 20 });
  }
}

// Why there are no cells; a cause that the page has no words for is said as it was told.
function reason({ why, said }) {
  return why || said ? t("map.no_cells", { why: why ? t(`map.none.${why}`) : said }) : "";
}

// Cells and way beside each other where they lie on the 180th meridian: else the map would show the whole Earth.
export function inOnePiece({ cells, way, about }) {
  const middle = first({ way, cells })[0];
  const beside = ([lon, lat]) => [lon + 360 * Math.round((middle - lon) / 360), lat];
  const features = cells.features.map((cell) => ({ ...cell, geometry: { ...cell.geometry, coordinates: cell.geometry.coordinates.map((ring) => ring.map(beside)) } }));
  return { cells: { ...cells, features }, way: way.map(beside), about };
}

function first({ way, cells }) {
  return way[0] ?? cells.features[0].geometry.coordinates[0][0];
}
