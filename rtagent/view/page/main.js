// The page: what it shows, and what its keys and buttons do.

import { Chooser } from "./chooser.js";
import { onKeys } from "./keys.js";
import { Histogram, showHappened, showReactions, showStreams } from "./panels.js";
import { Plots, layout } from "./plots.js";
import { connect } from "./stream.js";

const $ = (id) => document.getElementById(id);
const PAUSED = 250; // ms between frames while nothing moves
const SILENT = 3; // s without a record until a run is called silent
const MOST_HAPPENED = 1000;
const LEAST_SPAN = 0.001; // s

const view = { run: "", asked: "", span: 10, end: null }; // times in s of the run; end null: it follows the newest
let newest = 0;
let about = null;
let happened = [];
let frame = null; // one that is not drawn yet
let asked = 0;
let changed = true; // what the plots show, since the last wish
const measured = { frames: [], dropped: 0 }; // of the newest frames: newest record and paint (s since 1970), bytes
window.rtagentView = { measured, view };

const shown = () => {
  const end = view.end ?? newest;
  return { begin: end - view.span, end };
};
const plots = new Plots($("plots"), { view: shown, onZoom: (begin, end) => look(end - begin, end) });
const histogram = new Histogram($("histogram"));
const chooser = new Chooser($("choices"), $("filter"), { onChange: rebuild, onFull: (text) => say(text) });
const stream = connect({ onFrame, onSaid, onState: (open) => { if (!open) say("The view's server is gone; trying again.", false); else say(""); } });

// Frames: one is asked for at each tick, once the last has come

function tick(now) {
  const due = view.end === null || changed || now - asked > PAUSED;
  const arrived = frame;
  frame = null;
  const taken = arrived !== null && take(arrived.head);
  if (stream.ready && due) ask(now); // the server makes the next frame while this one is drawn
  if (taken) draw(arrived);
  requestAnimationFrame(tick);
}

function ask(now) {
  asked = now;
  changed = false;
  view.asked = view.run;
  const last = happened.length ? happened[happened.length - 1].number : 0;
  stream.wish({
    run: view.run, series: plots.keys, columns: plots.columns, span: view.span, end: view.end,
    about: about?.version ?? -1, happening: last,
  });
}

function onFrame(arrived) { frame = arrived; }

// Take what a frame tells; return false for one of a run that is not shown any more.
function take(head) {
  if (head.run !== view.run && view.asked !== view.run) return false;
  if (head.run !== view.run) begin(head.run);
  if (head.runs) showRuns(head.runs);
  if (head.newest !== undefined) newest = head.newest;
  if (head.about) { about = head.about; chooser.show(view.run, about); rebuild(); control(); }
  if (head.happened?.length) remember(head.happened);
  if (head.streams) showTables(head);
  return true;
}

function draw({ head, values, bytes }) {
  if (!head.series) return;
  $("time").textContent = `${newest.toFixed(2)} s`;
  plots.draw({ head, values });
  requestAnimationFrame(() => painted(head, bytes)); // by then the frame has been painted
}

function painted(head, bytes) {
  const at = (performance.timeOrigin + performance.now()) / 1000;
  measured.frames.push({ newest: head.newest_since_1970, at, bytes });
  if (measured.frames.length > 600) measured.frames.shift();
}

function showSpeed() {
  const recent = measured.frames.filter(({ at }) => at > (performance.timeOrigin + performance.now()) / 1000 - 1);
  if (!recent.length || recent[0].newest === null) { $("speed").textContent = ""; return; }
  const late = recent.map(({ newest: then, at }) => at - then).sort((a, b) => a - b)[recent.length >> 1];
  const size = recent.reduce((sum, { bytes }) => sum + bytes, 0) / 1000;
  const words = [`${recent.length} frames/s`, `${Math.round(size)} kB/s`];
  if (view.end === null && late < SILENT) words.push(`newest record to pixels ${Math.round(1000 * late)} ms`);
  $("speed").textContent = words.join(" · ");
}
setInterval(showSpeed, 500);

// What is shown

function begin(run) {
  Object.assign(view, { run, end: null });
  [about, happened, newest] = [null, [], 0];
  histogram.forget();
  changed = true;
  pressed();
}

function rebuild() {
  if (!about) return;
  const layouts = layout(about, chooser.chosen);
  $("empty").hidden = layouts.length > 0;
  if (!layouts.length) $("empty").textContent = "Nothing is chosen: choose signals at the left.";
  plots.show(layouts);
  changed = true;
}

function remember(items) {
  happened.push(...items.map(([number, time, kind, text]) => ({ number, time, kind, text })));
  happened = happened.slice(-MOST_HAPPENED);
  plots.happened = happened;
}

function showTables(head) {
  const ended = head.state.startsWith("ended");
  const silent = !ended && head.silent > SILENT;
  $("state").textContent = silent ? `silent for ${Math.round(head.silent)} s` : head.state || "no description yet";
  $("state").className = `pill ${ended || silent ? "warn" : "good"}`;
  showReactions(head.reactions, head.counted);
  histogram.show(head.reactions);
  showStreams(head.streams);
  showHappened(happened, head.counted);
}

function showRuns(runs) {
  const select = $("run");
  const told = JSON.stringify([runs, view.run]);
  if (select.dataset.told === told) return;
  select.dataset.told = told;
  select.replaceChildren(...runs.map(({ name, state }) => new Option(`${name}${state.startsWith("ended") ? " (ended)" : ""}`, name, false, name === view.run)));
}

// What is done

function look(span, end) {
  Object.assign(view, { span: Math.min(86400, Math.max(LEAST_SPAN, span)), end });
  changed = true;
  pressed();
}

function zoom(factor) {
  const { begin: from, end } = shown();
  if (view.end === null) look(view.span * factor, null);
  else look(view.span * factor, (from + end) / 2 + (view.span * factor) / 2);
}

const live = () => look(Number($("span").value), null);
const pause = () => (view.end === null ? look(view.span, newest) : live());
const move = (part) => look(view.span, shown().end + part * view.span);

function pressed() {
  $("pause").setAttribute("aria-pressed", String(view.end !== null));
}

function control() {
  const on = about?.control && !about.ended;
  const why = on ? "" : "The scenario has to say control = true under [telemetry], and the run to go on.";
  for (const control of [$("stop"), $("mark-text"), $("mark").querySelector("button")]) {
    control.disabled = !on;
    control.title = why;
  }
  const buttons = on ? about.buttons ?? [] : [];
  $("buttons").replaceChildren(...buttons.map((name) => {
    const button = Object.assign(document.createElement("button"), { textContent: `Press ${name}` });
    button.addEventListener("click", () => stream.command(view.run, "press", name));
    return button;
  }));
}

function mark(event) {
  event.preventDefault();
  stream.command(view.run, "annotate", $("mark-text").value || "mark");
  $("mark-text").value = "";
  $("mark-text").blur();
}

function stop() {
  if (!$("stop").disabled) stream.command(view.run, "stop", "stopped on the page of rtagent view");
}

function onSaid({ command, done, said }) {
  const what = { annotate: "Marked.", stop: "The run was told to stop.", press: "Pressed." }[command] ?? command;
  say(done ? what : `Not done (${command}): ${said}`, done);
}

let silence = 0;
function say(text, good = true) {
  clearTimeout(silence);
  Object.assign($("said"), { textContent: text, hidden: !text, className: good ? "good" : "bad" });
  if (good) silence = setTimeout(() => { $("said").hidden = true; }, 4000);
}

function theme(name) {
  document.documentElement.dataset.theme = name;
  histogram.forget();
  rebuild();
}
const dark = matchMedia("(prefers-color-scheme: dark)");
const other = () => theme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
dark.addEventListener("change", () => theme(dark.matches ? "dark" : "light"));

$("pause").addEventListener("click", pause);
$("live").addEventListener("click", live);
$("closer").addEventListener("click", () => zoom(0.5));
$("wider").addEventListener("click", () => zoom(2));
$("span").addEventListener("change", live);
$("mark").addEventListener("submit", mark);
$("stop").addEventListener("click", stop);
$("theme").addEventListener("click", other);
$("run").addEventListener("change", () => begin($("run").value));
onKeys({
  p: pause, l: live, "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2),
  ArrowLeft: () => move(-0.25), ArrowRight: () => move(0.25), t: other, S: stop,
  s: () => $("filter").focus(), r: () => $("run").focus(), m: () => $("mark-text").focus(),
});
theme(dark.matches ? "dark" : "light");
control();
requestAnimationFrame(tick);
