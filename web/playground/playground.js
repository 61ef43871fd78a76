/** The page: state in the address, controls, pictures as the stack moves. */
import { looped } from "../replay.js";
import { Module } from "../truestroke.js";
import { Chart } from "./charts.js";
import { LINES, Simulation } from "./simulation.js";

const data = PLAYGROUND_DATA; // web/build.py writes it: controllers, stack, sliders, a recorded run
const SWITCHES = { controller: ["none", "paper", "truestroke"], motion: ["waves", "sine", "scan"] };
const CHECKS = ["held", "change", "dead"];
const WORDS = { none: "no compensation", paper: "the paper's law", truestroke: "truestroke" };
const SHOWN = 0.05; // s of a frame, at most: after a pause the simulation does not hurry
const READ = 100; // ms between two figures: nobody reads faster
const SECOND = Math.round(data.controllers.truestroke.sample_rate);
const calm = matchMedia("(prefers-reduced-motion: reduce)");
const $ = (id) => document.getElementById(id);
const form = $("controls");

/* ---- State and address ---- */

const DEFAULTS = {
  ...{ controller: "none", motion: "waves", held: false, change: false, dead: false },
  ...Object.fromEntries(Object.entries(data.sliders).map(([name, s]) => [name, s.value])),
};

/** What the address says; what it does not, or says wrongly, is the default. */
function fromAddress() {
  const said = new URLSearchParams(location.hash.slice(1));
  const state = { ...DEFAULTS };
  for (const [name, words] of Object.entries(SWITCHES)) if (words.includes(said.get(name))) state[name] = said.get(name);
  for (const name of CHECKS) state[name] = said.get(name) === "1";
  for (const [name, { low, high }] of Object.entries(data.sliders)) {
    const value = Number.parseFloat(said.get(name));
    if (Number.isFinite(value)) state[name] = Math.min(Math.max(value, low), high);
  }
  return state;
}

/** Only what differs from the defaults. */
function toAddress(state) {
  const said = new URLSearchParams();
  for (const [name, value] of Object.entries(state)) if (value !== DEFAULTS[name]) said.set(name, value === true ? "1" : value);
  history.replaceState(null, "", `#${said}`);
}

/* ---- Controls ---- */

function addSliders() {
  for (const [name, { label, low, high, step }] of Object.entries(data.sliders)) {
    const row = document.createElement("label");
    row.innerHTML = `<span></span><output></output><input type="range">`;
    row.children[0].textContent = label;
    Object.assign(row.children[2], { name, min: low, max: high, step });
    $("sliders").append(row);
  }
}

/** The controls show the state. */
function show(state) {
  for (const name of Object.keys(SWITCHES)) form.elements[name].value = state[name];
  for (const name of CHECKS) form.elements[name].checked = state[name];
  for (const [name, { unit }] of Object.entries(data.sliders)) {
    const input = form.elements[name];
    input.value = state[name];
    input.previousElementSibling.textContent = `${state[name]} ${unit}`;
    input.setAttribute("aria-valuetext", `${state[name]} ${unit}`);
  }
}

/** A control has changed. */
function taken(state, { name, type, checked, value }) {
  state[name] = type === "checkbox" ? checked : type === "range" ? Number(value) : value;
  show(state);
  toAddress(state);
  if (name === "controller" || name === "motion") restart();
  else if (name === "held") simulation.hold(state);
  else if (name !== "dead" && name !== "speed") simulation.change(state);
}

/* ---- Pictures ---- */

/** Writes a text; one that stands there already is left alone, for each write lays out the page again. */
function write(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text;
}

const charts = Object.fromEntries(["loop", "slopes", "error"].map((id) => [id, new Chart($(id))]));
const length = (um) => (um < 0.0995 ? `${(1000 * um).toPrecision(2)} nm` : `${um.toPrecision(2)} µm`);
let reach = 1; // µm: of the picture of the error

function drawLoop() {
  const { desired, truth, ticks, kept } = simulation;
  const scans = state.motion === "scan";
  write("loop-title", scans ? "Image of squares of 3 µm" : "Displacement over desired displacement");
  if (scans) {
    charts.loop.begin([2, 26], [2, 26], "desired x, µm", "desired y, µm", true);
    charts.loop.image(simulation.image, LINES);
    return;
  }
  charts.loop.begin([0, 30], [0, 30], "desired, µm", "true, µm");
  charts.loop.curve(2, (i) => 30 * i, (i) => 30 * i, "desired", 1, [4, 4]);
  const count = Math.min(ticks, Math.round(SECOND * Math.min(2, Math.max(0.3, 3 / state.speed))), kept);
  const each = Math.max(1, Math.floor(SECOND / (100 * state.speed))); // ticks of a point: a hundred of the fastest period
  const place = (i) => (ticks - count + i * each) % kept;
  charts.loop.curve(Math.floor(count / each), (i) => desired[place(i)], (i) => truth[place(i)], "true", 1.5);
}

function drawError(most) {
  const { desired, truth, ticks, kept, seconds } = simulation;
  const count = Math.min(ticks, 2 * SECOND);
  const wanted = [0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50].find((limit) => limit >= 1.1 * most) ?? 100;
  reach = wanted > reach || wanted < reach / 4 ? wanted : reach;
  const small = reach < 0.5;
  const scale = small ? 1000 : 1;
  charts.error.begin([-2, 0], [-reach * scale, reach * scale], "time, s", small ? "error, nm" : "error, µm");
  const place = (i) => (ticks - count + i) % kept;
  charts.error.trace(count, (i) => (i - count) * seconds, (i) => scale * (truth[place(i)] - desired[place(i)]), "wrong", 1.2);
}

function drawSlopes() {
  const controller = simulation.axes[0].controller;
  const end = 2 * data.thresholds.at(-1);
  charts.slopes.begin([0, end], [0, 20], "volts since the turn, V", "slope, µm/V");
  charts.slopes.curve(2, (i) => i * end, () => data.sensitivity, "desired", 1, [4, 4]);
  if (!controller) return;
  const slopes = controller.slopes;
  const r = data.controllers[state.controller].members.thresholds;
  const x = (i) => 2 * r[Math.min((i + 1) >> 1, r.length - 1)];
  charts.slopes.curve(2 * slopes.length - 1, x, (i) => slopes[i >> 1], "true", 2);
}

function drawFigures({ rms, most }) {
  const share = ((100 * rms) / 24).toPrecision(2);
  write("figures", `${WORDS[state.controller]}: rms error ${length(rms)}, ${share} % of the motion; largest ${length(most)}`);
  const bits = simulation.flagsSince();
  const names = data.controllers.truestroke.flags.filter((_, i) => bits & (1 << i));
  write("flags", names.length ? `flags: ${names.join(", ")}` : "");
}

function draw(now) {
  drawLoop();
  drawError(simulation.errors(2 * SECOND).most);
  drawSlopes();
  if (Math.abs(now - said) < READ) return;
  drawFigures(simulation.errors(SECOND));
  said = now;
}

/* ---- Time ---- */

let before;
let running = !calm.matches;
let drawn = -Infinity; // ms
let said = -Infinity; // ms, of the figures

function frame(now) {
  const passed = Math.min((now - (before ?? now)) / 1000, SHOWN);
  before = now;
  if (running) simulation.run(state, Math.round(passed * SECOND));
  if (!calm.matches || now - drawn > 500) {
    draw(now);
    drawn = now;
  }
  requestAnimationFrame(frame);
}

function setRunning(on) {
  running = on;
  $("run").textContent = on ? "Pause" : "Run";
}

/** From rest; where nothing should move, the pictures show what the first seconds bring. */
function restart() {
  simulation.restart(state);
  if (calm.matches) simulation.run(state, 3 * SECOND);
}

/* ---- Begin ---- */

const module = await Module.load();
const simulation = new Simulation(module, data, 4 * SECOND);
let state = fromAddress();
addSliders();
show(state);
restart();
document.addEventListener("input", ({ target }) => target.form === form && taken(state, target)); // some stand above the form
form.addEventListener("submit", (event) => event.preventDefault());
$("run").addEventListener("click", () => setRunning(!running));
$("restart").addEventListener("click", () => restart());
$("defaults").addEventListener("click", () => begin({ ...DEFAULTS }));
addEventListener("resize", () => (drawn = -Infinity));
addEventListener("hashchange", () => begin(fromAddress()));

function begin(other) {
  state = other;
  show(state);
  toAddress(state);
  restart();
}

if (window.parent !== window) { // within a page of the site, whose frame then has no bar of its own
  const height = () => window.parent.postMessage({ height: document.documentElement.offsetHeight }, "*");
  new ResizeObserver(height).observe(document.documentElement);
}

setRunning(running);
requestAnimationFrame(frame);
setTimeout(() => {
  const { same, ticks } = looped(module, data.run);
  $("bits").textContent = `${same} of ${ticks} ticks of a recorded run have the bits of the Python package.`;
  document.documentElement.dataset.bits = `${same}/${ticks}`;
}, 500); // the stack moves first
