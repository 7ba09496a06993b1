// Live curves of one drone: place against reference, velocity, rates, simulated loss; and the cost of the plans.
import { curves } from "./canvas.js";
import { on, row, seen } from "./line.js";
import { make } from "./table.js";

const SECONDS = 30, STEP = 0.09, GAP = 0.5; // s: shown, between two samples at least, and that are joined at most
const AXES = ["--accent", "--good", "--warn"];
const PLAN = "mean cost of the plans, and of their relaxations (dashed), by round";
const PLOTS = {
  "place against reference (dashed), m": () => [0, 1, 2].flatMap((c) => [
    { name: "xyz"[c], values: kept("p", c), tint: AXES[c] }, { name: "", values: kept("r", c), tint: AXES[c], dashed: true }]),
  "velocity, m/s": () => [0, 1, 2].map((c) => ({ name: `v${"xyz"[c]}`, values: kept("v", c), tint: AXES[c] })),
  "body rates, rad/s": () => [0, 1, 2].map((c) => ({ name: "pqr"[c], values: kept("w", c), tint: AXES[c] })),
  "messages lost by the simulated network, %": () => [{ name: "lost", values: samples.map((s) => 100 * s.lost), tint: "--bad" }],
  [PLAN]: () => [
    { name: costs.length ? `round ${costs.at(-1)[0]}${above(...costs.at(-1))}` : "", values: costs.map((c) => c[1]), tint: "--accent" },
    { name: "", values: costs.map((c) => c[2]), tint: "--accent", dashed: true }],
};
let samples = [], costs = [], plotted;
const canvases = {};
const above = (round, cost, relaxed) => (relaxed && relaxed <= cost ? `, ${(100 * (cost / relaxed - 1)).toFixed(1)} % above the relaxation` : "");
const kept = (name, c) => samples.map((sample) => sample[name][c]);

function sample() {
  const t = seen.at, before = samples.at(-1)?.t;
  if (t < before) samples = []; // another server's clock
  else if (t - before < STEP) return;
  const of = row(Number(plotted.value));
  if (!of) return;
  if (!(of[13] < GAP)) return; // nothing newer was heard
  const lost = seen.drones.find(({ id }) => id === Number(plotted.value))?.lost ?? NaN;
  samples.push({ t, p: of.slice(0, 3), v: of.slice(3, 6), w: of.slice(10, 13), r: of.slice(14, 17), lost });
  samples = samples.filter((sample) => sample.t >= t - SECONDS);
}

function drawn(canvas, name) {
  const rounds = name === PLAN, x = rounds ? costs.map(([round]) => round) : samples.map(({ t }) => t);
  if (!x.length) return curves(canvas, [], "");
  const foot = rounds ? `rounds ${x[0]} to ${x.at(-1)}` : `${(x.at(-1) - x[0]).toFixed(1)} s`;
  curves(canvas, PLOTS[name](), foot, x, rounds ? Infinity : GAP);
}

function paint() {
  for (const [name, canvas] of Object.entries(canvases)) {
    if (canvas.clientWidth) drawn(canvas, name);
  }
}

export function start() {
  plotted = document.getElementById("plotted");
  const host = document.getElementById("plots");
  for (const name of Object.keys(PLOTS)) {
    canvases[name] = make("canvas", { role: "img", "aria-label": name === PLAN ? name : `${name} of the last ${SECONDS} s` });
    host.append(make("figure", {}, make("figcaption", {}, name), canvases[name]));
  }
  plotted.addEventListener("change", () => { samples = []; paint(); });
  on("frame", sample);
  on("costs", (told) => (costs = told));
  on("drones", paint);
}
