// Live curves of one drone: place against reference, velocity, rates, simulated loss; and the cost of the plans.
import { curves } from "./canvas.js";
import { on, row, seen } from "./line.js";
import { make } from "./table.js";

const SECONDS = 30, RATE = 10, LENGTH = SECONDS * RATE;
const AXES = ["--accent", "--good", "--warn"];
const PLAN = "mean cost of the plans, and bound (dashed), by round";
const PLOTS = {
  "place against reference (dashed), m": () => [0, 1, 2].flatMap((c) => [
    { name: "xyz"[c], values: kept("p", c), tint: AXES[c] }, { name: "", values: kept("r", c), tint: AXES[c], dashed: true }]),
  "velocity, m/s": () => [0, 1, 2].map((c) => ({ name: `v${"xyz"[c]}`, values: kept("v", c), tint: AXES[c] })),
  "body rates, rad/s": () => [0, 1, 2].map((c) => ({ name: "pqr"[c], values: kept("w", c), tint: AXES[c] })),
  "messages lost by the simulated network, %": () => [{ name: "lost", values: samples.map((s) => 100 * s.lost), tint: "--bad" }],
  [PLAN]: () => [
    { name: costs.length ? `round ${costs.at(-1)[1]}${gap(...costs.at(-1))}` : "", values: costs.map((c) => c[2]), tint: "--accent" },
    { name: "", values: costs.map((c) => c[3]), tint: "--accent", dashed: true }],
};
let samples = [], costs = [], at = 0, plotted;
const canvases = {};
const gap = (t, round, cost, relaxed) => (relaxed && relaxed <= cost ? `, gap ${(100 * (1 - relaxed / cost)).toFixed(1)} %` : "");
const kept = (name, c) => samples.map((sample) => sample[name][c]);

function sample() {
  if (seen.at - at < 1 / RATE && seen.at >= at) return;
  at = seen.at;
  const of = row(Number(plotted.value));
  if (!of) return;
  const lost = seen.drones.find(({ id }) => id === Number(plotted.value))?.lost ?? NaN;
  samples.push({ p: of.slice(0, 3), v: of.slice(3, 6), w: of.slice(10, 13), r: of.slice(14, 17), lost });
  if (samples.length > LENGTH) samples.shift();
}

function paint() {
  for (const [name, canvas] of Object.entries(canvases)) {
    if (canvas.clientWidth) curves(canvas, PLOTS[name](), name === PLAN ? "rounds" : `${(samples.length / RATE).toFixed(1)} s`);
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
  on("about", (about) => (costs = about.costs));
  on("costs", ([newest]) => { if (newest && newest[0] !== costs.at(-1)?.[0]) costs.push(newest); });
  on("drones", paint);
}
