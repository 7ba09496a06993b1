// Plot battery and link of the chosen drones over time; without a choice those of all drones.
import { curves } from "./canvas.js";
import { chosen, colour, nameOf, on, seen } from "./line.js";
import { make } from "./table.js";

const SHOWN_TIME = 600; // s
const SAMPLE_PERIOD = 0.9; // s, at least, between two samples
const MAX_GAP = 3; // s, longest time between two samples that are joined
const MAX_NAMED_CURVES = 12; // of more drones the curves have no names
const GOLDEN_ANGLE = 137.508; // degrees between the hues of two drones
const SECONDS_PER_MINUTE = 60;
// Each plot: its name, and its value for a drone.
const SWARM_PLOTS = {
  "battery, V": (d) => d.battery,
  "radio packets that the drone has not answered, %": (d) => (d.answered == null ? null : 100 * (1 - d.answered)),
  "round trip of a radio packet, ms": (d) => (d.latency == null ? null : 1000 * d.latency),
  "messages to other drones that the simulated network has lost, %": (d) => 100 * d.lost,
};
let samples = []; // each {t, values}, the values by drone in the order of SWARM_PLOTS; oldest first
const canvases = {};

function sample(drones) {
  const t = seen.at;
  const before = samples.at(-1)?.t;
  if (t < before) samples = []; // the clock of another server
  else if (t - before < SAMPLE_PERIOD) return;
  const values = new Map(drones.filter(({ heard }) => heard).map((d) => [d.id, Object.values(SWARM_PLOTS).map((value) => value(d))]));
  samples.push({ t, values });
  samples = samples.filter((one) => one.t >= t - SHOWN_TIME);
}

function tint(k) {
  return `hsl(${(GOLDEN_ANGLE * k) % 360} 70% ${colour("--curve-lightness")})`;
}

function paint() {
  const x = samples.map(({ t }) => t);
  if (!x.length) return;
  const minutes = (x.at(-1) - x[0]) / SECONDS_PER_MINUTE;
  const all = seen.about.ids;
  const ids = chosen() ?? all;
  Object.values(canvases).forEach((canvas, c) => {
    if (!canvas.clientWidth) return;
    const list = ids.map((i) => ({
      name: ids.length > MAX_NAMED_CURVES ? "" : `drone ${nameOf(i)}`,
      values: samples.map(({ values }) => values.get(i)?.[c] ?? NaN),
      tint: tint(all.indexOf(i)),
    }));
    curves(canvas, list, `${minutes.toFixed(1)} min`, x, MAX_GAP);
  });
}

export function start() {
  const host = document.getElementById("swarm-plots");
  for (const name of Object.keys(SWARM_PLOTS)) {
    canvases[name] = make("canvas", { role: "img", "aria-label": `${name}, of the last ${SHOWN_TIME / SECONDS_PER_MINUTE} min` });
    host.append(make("figure", {}, make("figcaption", {}, name), canvases[name]));
  }
  on("drones", (drones) => {
    sample(drones);
    paint();
  });
  on("selected", paint);
}
