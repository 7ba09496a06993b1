// The drawing tab: show the strokes drawn by hand and the planned path over them, in metres, and send the path to the
// selected drones.
import { ask, chosen, colour, nameOf, on, row, seen, selected, tell } from "./line.js";
import { showPaths } from "./scene.js";
import { curves, number, numbers, prepared } from "./canvas.js";

const find = (id) => document.getElementById(id);
const SETTING_FIELDS = ["height", "lift", "smoothing", "v_max", "a_max", "slower"]; // ids of fields
const OFFSET_FIELDS = ["offset_x", "offset_y", "offset_z"]; // ids of fields
const POINT_DISTANCE = 0.002; // m, closer points of a stroke are dropped
const LEAST_HEIGHT = 0.1; // m above the ground, of a trajectory that is flown as high as in its file
const PLAN_DELAY = 150; // ms after the last change before a plan is requested
const CLEARANCE_RADIUS = 0.4; // m, horizontal
const CLEARANCE_HEIGHT = 0.7; // m, vertical
let strokes = []; // each a list of [s, m, m]
let remarks = []; // about the file that was loaded
let current = null; // the stroke that is being drawn
let trajectory = null; // the file of a trajectory that was loaded instead of strokes: name and text
let plan = null; // the newest answer of the server
let began = 0; // ms, time stamp of the first point
let waiting = 0; // timer of the next planning request
let canvas;
let scale = 100; // pixels per metre
let middle = [0, 0]; // m, shown in the middle of the canvas

const toPixel = ([x, y]) => [canvas.clientWidth / 2 + scale * (x - middle[0]), canvas.clientHeight / 2 - scale * (y - middle[1])];
const toMetres = (px, py) => [(px - canvas.clientWidth / 2) / scale + middle[0], middle[1] - (py - canvas.clientHeight / 2) / scale];
const rounded = (x) => Math.round(1e4 * x) / 1e4;

// Scale the canvas to the fence, or to the area that the operator has set.
function fit() {
  if (!seen.about) return;
  const [low, high] = seen.about.fence;
  middle = [0, 1].map((c) => (low[c] + high[c]) / 2);
  const least = Math.min(canvas.clientWidth / (high[0] - low[0]), canvas.clientHeight / (high[1] - low[1]));
  scale = Math.max(least, Math.min(canvas.clientWidth, canvas.clientHeight) / number("area")) || 100;
  paint();
}

function polyline(pen, points, tint, width) {
  pen.strokeStyle = tint;
  pen.lineWidth = width;
  pen.beginPath();
  points.forEach((point, k) => (k ? pen.lineTo(...toPixel(point)) : pen.moveTo(...toPixel(point))));
  pen.stroke();
}

function paint() {
  const pen = prepared(canvas);
  if (!pen || !seen.about) return;
  const [low, high] = seen.about.fence;
  for (let x = Math.ceil(low[0]); x <= high[0]; x++) polyline(pen, [[x, low[1]], [x, high[1]]], colour(x ? "--rule" : "--faint"), 1);
  for (let y = Math.ceil(low[1]); y <= high[1]; y++) polyline(pen, [[low[0], y], [high[0], y]], colour(y ? "--rule" : "--faint"), 1);
  for (const points of plan ? ways() : []) polyline(pen, points, colour("--good"), 4);
  for (const stroke of current ? [...strokes, current] : strokes) polyline(pen, stroke.map((row) => row.slice(1)), colour("--ink"), 1.5);
  pen.fillStyle = colour("--accent");
  seen.about.ids.forEach((i, k) => {
    const at = seen.rows && [seen.rows[k * seen.about.columns], seen.rows[k * seen.about.columns + 1]];
    if (!at || !Number.isFinite(at[0])) return;
    const [x, y] = toPixel(at);
    pen.fillStyle = colour(selected.has(i) ? "--warn" : "--accent");
    pen.fillRect(x - 3, y - 3, 6, 6);
    pen.fillText(i, x + 5, y - 5);
  });
}

function point(event) {
  const area = canvas.getBoundingClientRect();
  const [x, y] = toMetres(event.clientX - area.left, event.clientY - area.top);
  return [rounded((event.timeStamp - began) / 1000), rounded(x), rounded(y)];
}

const close = ([, a, b], [, x, y]) => Math.hypot(a - x, b - y) < POINT_DISTANCE;

// Append a point to a stroke. Replace the last point if it is too close to its predecessor, so that the stroke always ends
// at the pointer.
function extend(stroke, point) {
  if (stroke.length > 1 && close(stroke.at(-1), stroke.at(-2))) stroke.pop();
  stroke.push(point);
}

function pointers() {
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    trajectory = null;
    if (!strokes.length) began = event.timeStamp;
    current = [point(event)];
    event.preventDefault();
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!current) return;
    const moves = event.getCoalescedEvents?.().length ? event.getCoalescedEvents() : [event];
    for (const move of moves) extend(current, point(move));
    paint();
  });
  const end = () => {
    if (!current) return;
    strokes.push(current);
    current = null;
    changed();
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
}

function said(text) {
  find("plan").textContent = text;
}

const isThere = () => trajectory || strokes.length;

// Drop the plan after a change, and request a new one after a short delay.
function changed() {
  plan = null;
  showPaths([]);
  curves(find("profile"), [], "");
  paint();
  clearTimeout(waiting);
  if (!isThere()) return said("Nothing is drawn.");
  said("Planning ...");
  waiting = setTimeout(() => {
    const yaw = find("yaw").value;
    const values = numbers(...SETTING_FIELDS);
    if (!values) return;
    const settings = Object.fromEntries(SETTING_FIELDS.map((name, k) => [name, values[k]]));
    if (trajectory) return ask({ ask: "trajectory", ...trajectory, height: settings.height, slower: settings.slower });
    ask({ ask: "draw", strokes, ...settings, yaw: yaw === "along" ? yaw : Number(yaw), timing: find("timing").value });
  }, PLAN_DELAY);
}

// Return the path of each selected drone: the k-th path is shifted by k offsets. With no selection, return the planned path.
function ways() {
  const offset = OFFSET_FIELDS.map(number);
  return (chosen() ?? [0]).map((i, k) => plan.points.map((point) => point.map((x, c) => (k ? x + k * offset[c] : x))));
}

// Return the drones in the air that are not selected and hover too close to a path. A drone on the path gives way to them and
// does not reach the end of its path.
function inTheWay(paths) {
  const others = seen.about.ids.filter((i) => !selected.has(i) && [...(row(i) ?? [])].slice(0, 3).every(Number.isFinite));
  const near = (p, [x, y, z]) => Math.hypot(Math.hypot(p[0] - x, p[1] - y) / CLEARANCE_RADIUS, (p[2] - z) / CLEARANCE_HEIGHT) < 1;
  return others.filter((i) => row(i)[2] > seen.about.ground + 0.1 && paths.some((points) => points.some((point) => near(row(i), point))));
}

function planned(made) {
  plan = made;
  curves(find("profile"), [
    { name: "speed, m/s", values: made.speeds, tint: "--accent" }, { name: "acceleration, m/s²", values: made.accelerations, tint: "--warn" },
  ], `${made.duration.toFixed(1)} s`);
  show();
}

function show() {
  if (!plan) return;
  const paths = ways();
  const others = inTheWay(paths);
  const { duration, speed, acceleration, deviation } = plan;
  showPaths(paths);
  const warning = others.length ? `. In the way, where they are now: drone ${others.map(nameOf).join(", ")}` : "";
  const more = remarks.map((remark) => `. The file: ${remark}`).join("");
  const limits = `${duration} s, at most ${speed} m/s and ${acceleration} m/s²`;
  const away = trajectory ? trajectory.name : `at most ${Math.round(1000 * deviation)} mm away from the drawing`;
  said(`${limits}, ${away}${warning}${more}`);
  paint();
}

function download({ text, kind }) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: kind === "svg" ? "image/svg+xml" : "text/csv" }));
  link.download = `drawing.${kind}`;
  link.click();
  URL.revokeObjectURL(link.href);
}

export const sketch = {
  undo: () => {
    strokes.pop();
    changed();
  },
  clear: () => {
    strokes = [];
    remarks = [];
    trajectory = null;
    changed();
  },
  save: (kind) => (strokes.length ? ask({ ask: "save", strokes, kind }) : said("Nothing is drawn.")),
  strokes: () => strokes,
  fly: () => {
    if (!chosen()) return tell("refused", "fly: choose the drones in the table");
    if (!plan) return tell("refused", "fly: nothing is planned");
    const offset = numbers(...OFFSET_FIELDS);
    if (offset) ask({ ask: "fly", drones: chosen(), offset });
  },
};

export function start() {
  canvas = find("sketch");
  pointers();
  new ResizeObserver(fit).observe(canvas);
  find("area").addEventListener("change", fit);
  for (const name of [...SETTING_FIELDS, "yaw", "timing"]) find(name).addEventListener("change", changed);
  for (const name of OFFSET_FIELDS) find(name).addEventListener("change", show);
  find("file").addEventListener("change", async ({ target }) => {
    const [file] = target.files;
    if (file) ask({ ask: "load", name: file.name, text: await file.text() });
    target.value = "";
  });
  on("about", fit);
  on("connected", (there) => there && isThere() && changed()); // the server has no plan for a new connection
  on("plan", planned);
  on("selected", show);
  on("remarks", (words) => {
    remarks = words;
  });
  on("strokes", (loaded) => {
    strokes = loaded;
    trajectory = null;
    changed();
  });
  on("trajectory", ({ name, text, height }) => {
    strokes = [];
    remarks = [];
    trajectory = { name, text };
    if (height > seen.about.ground + LEAST_HEIGHT) find("height").value = height;
    changed();
  });
  on("saved", download);
  on("refused", (why) => isThere() && !plan && said(why));
  on("drones", () => canvas.clientWidth && paint());
  on("theme", paint);
}
