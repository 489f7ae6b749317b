// Beside the plots: the reaction-time histogram, what happened, and what came of each stream.

import uPlot from "./uplot/uPlot.esm.js";
import { colour, decades, micros } from "./plots.js";

const HEIGHT = 140;
const LISTED = 200;
const NAMES = { annotation: "mark" };

export class Histogram {
  constructor(place) { this.place = place; this.drawn = null; }

  forget() { this.drawn?.destroy(); this.drawn = null; }

  show(reactions) {
    if (!reactions.count) { this.forget(); return; }
    this.drawn ??= new uPlot(this.#options(), [[], []], this.place);
    this.drawn.setData([reactions.edges, reactions.counts]);
    const [median, p99] = reactions.parts.reaction;
    this.place.setAttribute("aria-label", `Reaction times: median ${micros(median)}, p99 ${micros(p99)}`);
  }

  #options() {
    const axis = { stroke: colour("--quiet"), grid: { stroke: colour("--grid"), width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
    return {
      width: this.place.clientWidth, height: HEIGHT, padding: [6, 20, 0, 0],
      legend: { show: false }, cursor: { show: false },
      scales: { x: { time: false, distr: 3 }, y: { range: (_, low, high) => [0, Math.max(1, high)] } },
      axes: [
        { ...axis, size: 24, splits: decades, filter: (_, ticks) => ticks, values: (_, ticks) => ticks.map(micros) },
        { ...axis, size: 34, incrs: [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 100000] },
      ],
      series: [{}, {
        stroke: colour("--s1"), fill: `${colour("--s1")}55`, width: 1, points: { show: false },
        paths: uPlot.paths.stepped({ align: 1 }),
      }],
    };
  }
}

export function table(place, titles, rows) {
  const body = [row("th", titles.map((text) => ({ text }))), ...rows.map((cells) => row("td", cells))];
  place.replaceChildren(...body);
}

function row(kind, cells) {
  const made = document.createElement("tr");
  made.append(...cells.map(({ text, bad }) => Object.assign(document.createElement(kind), { textContent: text, className: bad ? "bad" : "" })));
  return made;
}

export function showReactions(reactions, counted) {
  const missed = counted["missed reactions"] ?? 0;
  document.getElementById("reaction-count").textContent = `${reactions.count ?? 0}${missed ? `, ${missed} missed` : ""}`;
  const place = document.getElementById("reaction-parts");
  document.getElementById("histogram").hidden = !reactions.count;
  if (!reactions.count) { place.replaceChildren(row("td", [{ text: "None yet." }])); return; }
  const parts = Object.entries(reactions.parts);
  table(place, ["", "median", "p99", "max"], parts.map(([name, values]) => [{ text: name }, ...values.map((each) => ({ text: micros(each) }))]));
}

export function showStreams(streams) {
  const missed = streams.reduce((sum, [, , , each]) => sum + each, 0);
  document.getElementById("missed").textContent = missed ? `${missed} missed` : "nothing missed";
  const rows = streams.map(([name, rate, count, gone]) => [
    { text: name }, { text: Math.round(rate).toLocaleString("en") }, { text: count.toLocaleString("en") },
    { text: gone.toLocaleString("en"), bad: gone > 0 },
  ]);
  table(document.getElementById("streams"), ["", "a second", "all", "missed"], rows);
}

export function showHappened(happened, counted) {
  const faults = counted.fault ?? 0;
  document.getElementById("happened-count").textContent = faults ? `${faults} faults` : "no fault";
  const items = happened.slice(-LISTED).reverse().map(({ time, kind, text }) => {
    const item = document.createElement("li");
    item.append(
      Object.assign(document.createElement("time"), { textContent: time.toFixed(2) }),
      Object.assign(document.createElement("span"), { textContent: NAMES[kind] ?? kind, className: `kind ${kind}` }),
      Object.assign(document.createElement("span"), { textContent: text }),
    );
    return item;
  });
  document.getElementById("happened").replaceChildren(...(items.length ? items : ["Nothing yet."]));
}
