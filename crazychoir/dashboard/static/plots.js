// Plot live curves of one drone (position and reference, velocity, body rates, simulated loss) and the cost of the plans.
import { curves } from "./canvas.js";
import { on, row, seen } from "./line.js";
import { make } from "./table.js";

const SHOWN_TIME = 30; // s
const SAMPLE_PERIOD = 0.09; // s, at least, between two samples
const MAX_GAP = 0.5; // s, longest time between two samples that are joined; a pose of a greater age is not sampled
const AXIS_COLOURS = ["--accent", "--good", "--warn"]; // of x, y and z
const COST_PLOT = "mean cost of the plans, and of their relaxations (dashed), by round";
const PLOT_CURVES = {
  "place against reference (dashed), m": () => [0, 1, 2].flatMap((c) => [
    { name: "xyz"[c], values: kept("p", c), tint: AXIS_COLOURS[c] }, { name: "", values: kept("r", c), tint: AXIS_COLOURS[c], dashed: true }]),
  "velocity, m/s": () => [0, 1, 2].map((c) => ({ name: `v${"xyz"[c]}`, values: kept("v", c), tint: AXIS_COLOURS[c] })),
  "body rates, rad/s": () => [0, 1, 2].map((c) => ({ name: "pqr"[c], values: kept("w", c), tint: AXIS_COLOURS[c] })),
  "messages lost by the simulated network, %": () => [{ name: "lost", values: samples.map((s) => 100 * s.lost), tint: "--bad" }],
  [COST_PLOT]: () => [
    { name: costs.length ? `round ${costs.at(-1)[0]}${above(...costs.at(-1))}` : "", values: costs.map((c) => c[1]), tint: "--accent" },
    { name: "", values: costs.map((c) => c[2]), tint: "--accent", dashed: true }],
};
let samples = []; // of the drone that is plotted, oldest first
let costs = []; // each [round, mean cost, mean cost of the relaxations]
let plotted; // the list in which the operator chooses the drone
const canvases = {};
const above = (round, cost, relaxed) => (relaxed && relaxed <= cost ? `, ${(100 * (cost / relaxed - 1)).toFixed(1)} % above the relaxation` : "");
const kept = (name, c) => samples.map((sample) => sample[name][c]);

function sample() {
  const t = seen.at;
  const before = samples.at(-1)?.t;
  if (t < before) samples = []; // the clock of another server
  else if (t - before < SAMPLE_PERIOD) return;
  const state = row(Number(plotted.value));
  if (!state) return;
  if (!(state[13] < MAX_GAP)) return; // no recent pose
  const lost = seen.drones.find(({ id }) => id === Number(plotted.value))?.lost ?? NaN;
  samples.push({ t, p: state.slice(0, 3), v: state.slice(3, 6), w: state.slice(10, 13), r: state.slice(14, 17), lost });
  samples = samples.filter((sample) => sample.t >= t - SHOWN_TIME);
}

function drawn(canvas, name) {
  const rounds = name === COST_PLOT;
  const x = rounds ? costs.map(([round]) => round) : samples.map(({ t }) => t);
  if (!x.length) return curves(canvas, [], "");
  const foot = rounds ? `rounds ${x[0]} to ${x.at(-1)}` : `${(x.at(-1) - x[0]).toFixed(1)} s`;
  curves(canvas, PLOT_CURVES[name](), foot, x, rounds ? Infinity : MAX_GAP);
}

function paint() {
  for (const [name, canvas] of Object.entries(canvases)) {
    if (canvas.clientWidth) drawn(canvas, name);
  }
}

export function start() {
  plotted = document.getElementById("plotted");
  const host = document.getElementById("plots");
  for (const name of Object.keys(PLOT_CURVES)) {
    canvases[name] = make("canvas", { role: "img", "aria-label": name === COST_PLOT ? name : `${name} of the last ${SHOWN_TIME} s` });
    host.append(make("figure", {}, make("figcaption", {}, name), canvases[name]));
  }
  plotted.addEventListener("change", () => {
    samples = [];
    paint();
  });
  on("frame", sample);
  on("costs", (told) => (costs = told));
  on("drones", paint);
}
