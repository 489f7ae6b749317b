// The plots over time: one for each unit of the chosen signals, one for each chosen demon, one of the components.

import { sorted } from "./chooser.js";
import uPlot from "./uplot/uPlot.esm.js";

const HEIGHT = { least: 110, most: 260 }; // px; in between, all plots fill the page
const ABOVE = 84; // px of a card, and between two, that are no plot
const NEAR = 40; // columns within which a cursor finds a value
const GAP = 20; // px at the right, for half of the last label
const BESIDE = 22; // px that a card is wider than its plot
const TOLD = 250; // ms between the newest values in legends
const SHOWN = ["annotation", "stop", "press", "fault", "missed", "stimulus"]; // are lines in every plot

export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export function short(value) {
  if (value == null || Number.isNaN(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e5 || size < 1e-3)) return value.toExponential(2);
  return String(Number(value.toPrecision(4)));
}

export function micros(value) {
  if (value == null || Number.isNaN(value)) return "–";
  if (value >= 1e6) return `${short(value / 1e6)} s`;
  return value >= 1000 ? `${short(value / 1000)} ms` : `${short(value)} µs`;
}

// The powers of ten on a logarithmic axis.
export function decades(_, axis, low, high) {
  const first = Math.ceil(Math.log10(low) - 1e-9);
  const count = Math.max(0, Math.floor(Math.log10(high) + 1e-9) - first + 1);
  return Array.from({ length: count }, (_, place) => 10 ** (first + place));
}

// Which plots there are to be, each with a title and its series.
export function layout(about, chosen) {
  const plots = new Map();
  const add = (id, plot, series) => {
    if (!plots.has(id)) plots.set(id, { id, series: [], ...plot });
    plots.get(id).series.push(series);
  };
  for (const signal of sorted(about.signals)) {
    if (!chosen.has(signal.key)) continue;
    const id = signal.unit ? `unit ${signal.unit}` : signal.key;
    const label = signal.group === "agent" ? signal.column : `${signal.group}.${signal.column}`;
    add(id, { title: signal.unit ? `Signals in ${signal.unit}` : label }, { key: signal.key, label, steps: signal.column === "action" });
  }
  (about.demons ?? []).forEach((demon, place) => {
    const key = `prediction/${place}`;
    if (!chosen.has(key)) return;
    const plot = { title: demon.name, note: demon.known ? "prediction and return" : "prediction; its return is not known" };
    add(key, plot, { key, label: "prediction" });
    if (demon.known) add(key, plot, { key: `return/${place}`, label: "return", dash: [6, 4] });
  });
  for (const name of about.components) {
    if (chosen.has(`components/${name}`)) {
      add("components", { title: "Component times", log: true }, { key: `components/${name}`, label: name });
    }
  }
  return [...plots.values()];
}

export class Plots {
  constructor(place, { onZoom, view }) {
    this.place = place;
    this.onZoom = onZoom;
    this.view = view;
    this.plots = [];
    this.happened = [];
    this.told = 0; // when the legends last told the newest values
    new ResizeObserver(() => this.#resize()).observe(place);
  }

  get columns() {
    const inner = Math.min(2000, Math.max(...this.plots.map(({ drawn }) => drawn.bbox.width / devicePixelRatio)));
    return Math.max(50, Math.round(inner));
  }

  get keys() { return this.plots.flatMap(({ plot }) => plot.series.map(({ key }) => key)); }

  show(layouts) {
    for (const { drawn, card } of this.plots) { drawn.destroy(); card.remove(); }
    this.plots = layouts.map((plot) => this.#make(plot));
    this.#resize();
  }

  draw({ head, values }) {
    const xs = new Float64Array(2 * head.columns);
    for (let place = 0; place < xs.length; place++) xs[place] = head.first + head.width * (place / 2 + 0.25);
    const tells = performance.now() - this.told > TOLD;
    if (tells) this.told = performance.now();
    for (const { plot, drawn } of this.plots) {
      drawn.setData([xs, ...plot.series.map(({ key }) => known(values.get(key), xs.length, plot.log))]);
      if (tells) tellNewest(drawn);
    }
  }

  #resize() {
    const height = this.#height();
    for (const { drawn, card } of this.plots) drawn.setSize({ width: width(card), height });
  }

  #height() {
    const across = getComputedStyle(this.place).gridTemplateColumns.split(" ").length;
    const down = Math.max(1, Math.ceil(this.plots.length / across));
    const each = Math.floor((this.place.clientHeight - 10) / down) - ABOVE;
    return Math.max(HEIGHT.least, Math.min(HEIGHT.most, each));
  }

  #make(plot) {
    const card = document.createElement("div");
    card.className = "plot";
    card.dataset.plot = plot.id;
    card.tabIndex = 0;
    card.setAttribute("role", "img");
    card.setAttribute("aria-label", `${plot.title}: ${plot.series.map(({ label }) => label).join(", ")}`);
    const title = document.createElement("h2");
    title.append(plot.title);
    if (plot.note) title.append(Object.assign(document.createElement("span"), { textContent: plot.note }));
    card.append(title);
    this.place.append(card);
    return { plot, card, drawn: new uPlot(this.#options(plot, width(card)), [[], ...plot.series.map(() => [])], card) };
  }

  #options(plot, width) {
    const say = plot.log ? micros : short;
    const axis = { stroke: colour("--quiet"), grid: { stroke: colour("--grid"), width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
    return {
      width,
      height: HEIGHT.least,
      padding: [6, GAP, 0, 0],
      legend: { live: true },
      cursor: { sync: { key: "time" }, drag: { x: true, y: false, setScale: false }, points: { size: 6 }, dataIdx: nearest },
      scales: {
        x: { time: false, range: () => { const { begin, end } = this.view(); return [begin, end]; } },
        y: plot.log ? { distr: 3 } : {},
      },
      axes: [
        { ...axis, size: 26, values: (_, ticks) => ticks.map((tick) => `${Number(tick.toPrecision(9))} s`) },
        { ...axis, size: 56, values: (_, ticks) => ticks.map(say), ...(plot.log ? { splits: decades, filter: (_, ticks) => ticks } : {}) },
      ],
      series: [
        { label: "time", value: (_, value) => (value == null ? "" : `${value.toFixed(3)} s`) },
        ...plot.series.map(({ label, dash }, place) => ({
          label, dash, spanGaps: true, width: dash ? 1.5 : 1.25, points: { show: false },
          stroke: colour(`--s${(place % 8) + 1}`), value: (_, value) => say(value),
        })),
      ],
      hooks: { draw: [(drawn) => this.#lines(drawn)], setSelect: [(drawn) => this.#selected(drawn)] },
    };
  }

  #lines(drawn) {
    const { begin, end } = this.view();
    const { ctx, bbox } = drawn;
    ctx.save();
    for (const { time, kind } of this.happened) {
      if (time < begin || time > end || !SHOWN.includes(kind)) continue;
      const name = kind === "annotation" ? "--accent" : kind === "stimulus" ? "--warn" : "--bad";
      ctx.strokeStyle = colour(name);
      const isThin = kind === "stimulus" || kind === "missed";
      ctx.globalAlpha = isThin ? 0.5 : 0.9;
      ctx.lineWidth = devicePixelRatio * (isThin ? 1 : 2);
      ctx.setLineDash([]);
      const x = drawn.valToPos(time, "x", true);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
    }
    ctx.restore();
  }

  #selected(drawn) {
    const { left, width } = drawn.select;
    if (width < 4) return;
    this.onZoom(drawn.posToVal(left, "x"), drawn.posToVal(left + width, "x"));
    drawn.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
  }
}

// The nearest place with a value of a series: in most columns only some of the series have one.
function nearest(drawn, series, place) {
  const values = drawn.data[series];
  if (series === 0 || place == null) return place;
  for (let away = 0; away <= NEAR; away++) {
    if (values[place - away] != null) return place - away;
    if (values[place + away] != null) return place + away;
  }
  return place;
}

const width = (card) => Math.max(200, card.clientWidth - BESIDE);

// While nobody points at a plot, its legend tells the newest values.
function tellNewest(drawn) {
  if (drawn.cursor.left >= 0) return;
  const last = drawn.data.map((values) => values.findLastIndex((value) => value != null));
  drawn.setLegend({ idxs: last.map((place) => (place < 0 ? null : place)) }, false);
}

// uPlot knows a missing value as null, and a logarithm none of what is not positive.
function known(values, length, log) {
  const out = new Array(length).fill(null);
  if (values === undefined || values.length !== length) return out;
  for (let place = 0; place < length; place++) {
    const value = values[place];
    if (value === value && !(log && value <= 0)) out[place] = value;
  }
  return out;
}
