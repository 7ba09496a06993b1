// Show the room in three dimensions: drones, trails, references, routes, communication graph, tasks, fence, and the planned
// path.
import { THREE, OrbitControls } from "/three/index.js";
import { colour, on, seen, selected, tell } from "./line.js";

const TRAIL_SEGMENTS = 120; // segments of a drone's trail
const TRAIL_PERIOD = 0.1; // s between two segments of a trail
const ARM_LENGTH = 0.13; // m, of the shape that shows a drone
const SCENE_TEXT = "The room from above and from the side: drones, trails, routes, fence, tasks. The table shows the same in words.";
const MAX_LABELS = 40; // drones, or tasks; of more none has a label
let renderer;
let camera;
let controls;
let scene;
let host;
let drones;
let references;
let trails;
let edges;
let path;
let tasks;
let room;
let routes;
let labels = []; // of the drones
let links = []; // edges of the graph: {ends, name}
let legs = []; // of the routes: {k, first, count}
let waiting = 0; // id of the next animation frame; 0: none is requested
let trailed = 0; // segments that each trail has had
let drawn = -1; // s, when the last segment was added
let looked = false; // whether the camera has been placed
let tasked = "null"; // the tasks that are shown, as JSON
let routed = "{}"; // the routes that are shown, as JSON
let apart; // colour of an edge between drones that do not hear each other

const at = (rows, k, c) => rows[k * seen.about.columns + c];
const lines = (material) => unbounded(new THREE.LineSegments(new THREE.BufferGeometry(), material));

// Exempt an object from frustum culling: its positions change and some are NaN, so its bounds cannot be computed.
function unbounded(object) {
  object.frustumCulled = false;
  object.geometry.boundingSphere = new THREE.Sphere();
  return object;
}

function body() {
  const boxes = [[2 * ARM_LENGTH, 0.03, 0.03, 0], [2 * ARM_LENGTH, 0.03, 0.03, Math.PI / 2], [0.09, 0.06, 0.06, Math.PI / 4]];
  const parts = boxes.map(([x, y, z, turn]) => new THREE.BoxGeometry(x, y, z).rotateZ(turn + Math.PI / 4).toNonIndexed());
  const merged = new THREE.BufferGeometry();
  for (const name of ["position", "normal"]) {
    const data = parts.flatMap((part) => [...part.getAttribute(name).array]);
    merged.setAttribute(name, new THREE.Float32BufferAttribute(data, 3));
  }
  return merged;
}

function label(text, size = 0.28) {
  const canvas = document.createElement("canvas");
  canvas.width = 64;
  canvas.height = 64;
  const pen = canvas.getContext("2d");
  pen.font = `bold ${Math.min(40, 100 / text.length)}px system-ui`;
  pen.textAlign = "center";
  pen.fillStyle = colour("--ink");
  pen.fillText(text, 32, 46);
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(canvas), depthTest: false }));
  sprite.scale.set(size, size, 1);
  return sprite;
}

function box(low, high, tint) {
  const size = high.map((x, c) => x - low[c]);
  const shape = new THREE.EdgesGeometry(new THREE.BoxGeometry(...size));
  const frame = new THREE.LineSegments(shape, new THREE.LineBasicMaterial({ color: tint }));
  frame.position.set(...low.map((x, c) => x + size[c] / 2));
  return frame;
}

function build(about) {
  scene.clear();
  labels = [];
  tasked = "null";
  routed = "{}";
  trailed = 0;
  const n = about.ids.length;
  const [low, high] = about.fence;
  scene.add(new THREE.HemisphereLight(0xffffff, 0x8899aa, 4));
  room = new THREE.Group();
  const reach = Math.max(high[0] - low[0], high[1] - low[1]);
  const grid = new THREE.GridHelper(2 * Math.ceil(reach / 2), 2 * Math.ceil(reach / 2), colour("--ink"), colour("--rule"));
  grid.rotation.x = Math.PI / 2;
  grid.position.set(Math.round((low[0] + high[0]) / 2), Math.round((low[1] + high[1]) / 2), about.ground);
  room.add(grid, box(low, high, colour("--accent")), box(about.limit[0], about.limit[1], colour("--bad")));
  scene.add(room);
  apart = colour("--faint");
  drones = new THREE.InstancedMesh(body(), new THREE.MeshLambertMaterial(), n);
  scene.add(unbounded(drones));
  references = unbounded(new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ size: 0.06, color: colour("--warn") })));
  references.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * n), 3));
  trails = lines(new THREE.LineBasicMaterial({ color: colour("--accent"), transparent: true, opacity: 0.5 }));
  trails.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(6 * n * TRAIL_SEGMENTS), 3));
  edges = lines(new THREE.LineBasicMaterial({ vertexColors: true }));
  edges.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(6 * about.edges.length), 3));
  edges.geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(6 * about.edges.length), 3));
  path = lines(new THREE.LineBasicMaterial({ color: colour("--good") }));
  const place = new Map(about.ids.map((i, k) => [i, k]));
  links = about.edges.map(([i, j]) => ({ ends: [place.get(i), place.get(j)], name: `${i}-${j}` }));
  tasks = new THREE.Group();
  routes = lines(new THREE.LineDashedMaterial({ vertexColors: true, dashSize: 0.12, gapSize: 0.08 }));
  legs = [];
  scene.add(references, trails, edges, path, tasks, routes);
  if (n <= MAX_LABELS) {
    labels = about.ids.map((i) => label(String(i)));
    scene.add(...labels);
  }
  looked = false;
}

// Place the camera where all drones are well in view. Repeat it until a position of every drone is known.
function look(about, rows) {
  const spots = about.ids.map((i, k) => [at(rows, k, 0), at(rows, k, 1)]).filter((spot) => spot.every(Number.isFinite));
  if (!spots.length) return;
  const low = [0, 1].map((c) => Math.min(...spots.map((spot) => spot[c])));
  const high = [0, 1].map((c) => Math.max(...spots.map((spot) => spot[c])));
  const x = (low[0] + high[0]) / 2;
  const y = (low[1] + high[1]) / 2;
  const reach = Math.max(3.5, 1.2 * Math.hypot(high[0] - low[0], high[1] - low[1]));
  camera.position.set(x, y - reach, about.ground + 0.3 + 0.8 * reach);
  controls.target.set(x, y, about.ground + 0.4);
  controls.update();
  looked = spots.length === about.ids.length;
}

// Return the colour of drone i, which has row k.
function tint(i, k, rows) {
  const drone = seen.drones[k];
  if (!drone?.heard || !(at(rows, k, 13) < 1)) return colour("--faint");
  if (drone.phase === "stopped" || drone.gone.length) return colour("--bad");
  if (selected.has(i)) return colour("--warn");
  return colour(drone.phase === "on ground" ? "--rest" : "--accent");
}

// Objects that are reused in every frame.
const matrix = new THREE.Matrix4();
const turn = new THREE.Quaternion();
const where = new THREE.Vector3();
const paint = new THREE.Color();
const unit = new THREE.Vector3(1, 1, 1);
const none = new THREE.Matrix4().makeScale(0, 0, 0);

// Request a redraw at the browser's next animation frame, so that a slow browser draws less often and does not fall behind.
function soon() {
  if (waiting) return;
  waiting = requestAnimationFrame(() => {
    waiting = 0;
    show(seen);
  });
}

function show({ about, rows }) {
  if (!about || !rows) return;
  if (!looked) look(about, rows);
  const repaint = seen.received % 10 === 1;
  about.ids.forEach((i, k) => {
    where.set(at(rows, k, 0), at(rows, k, 1), at(rows, k, 2));
    const there = Number.isFinite(where.x);
    turn.set(at(rows, k, 6), at(rows, k, 7), at(rows, k, 8), at(rows, k, 9));
    drones.setMatrixAt(k, there ? matrix.compose(where, turn, unit) : none);
    if (repaint) drones.setColorAt(k, paint.set(tint(i, k, rows)));
    if (labels[k]) labels[k].position.set(where.x, where.y, where.z + 0.2);
    if (labels[k]) labels[k].visible = there;
    references.geometry.attributes.position.setXYZ(k, at(rows, k, 14), at(rows, k, 15), at(rows, k, 16));
  });
  drones.instanceMatrix.needsUpdate = true;
  if (drones.instanceColor) drones.instanceColor.needsUpdate = true;
  references.geometry.attributes.position.needsUpdate = true;
  if (seen.at - drawn >= TRAIL_PERIOD || seen.at < drawn) trail(about, rows);
  connectEdges(rows);
  if (legs.length) leave(about, rows, repaint);
  renderer.render(scene, camera);
}

const last = new Map(); // by drone: its position when the last segment was added

// Add a segment to each trail, in place of its oldest segment.
function trail(about, rows) {
  drawn = seen.at;
  const points = trails.geometry.attributes.position;
  const slot = trailed % TRAIL_SEGMENTS;
  trailed += 1;
  about.ids.forEach((i, k) => {
    const now = [at(rows, k, 0), at(rows, k, 1), at(rows, k, 2)];
    const before = last.get(i) ?? now;
    const ends = now.every(Number.isFinite) ? [...before, ...now] : new Array(6).fill(NaN);
    points.array.set(ends, 6 * (k * TRAIL_SEGMENTS + slot));
    last.set(i, now);
  });
  points.needsUpdate = true;
}

const misses = (one, other) => one && [...one.suspect, ...one.gone].includes(other.id);

function connectEdges(rows) {
  const { position, color } = edges.geometry.attributes;
  links.forEach(({ ends, name }, e) => {
    const pair = ends.map((k) => seen.drones[k]);
    const lost = seen.links?.[name] ?? (seen.drones.length ? (pair[0].lost + pair[1].lost) / 2 : 0);
    if (misses(...pair) || misses(...pair.reverse())) paint.set(apart);
    else paint.setHSL(0.33 * (1 - Math.min(1, 1.5 * lost)), 0.75, 0.45);
    ends.forEach((k, end) => {
      position.setXYZ(2 * e + end, at(rows, k, 0), at(rows, k, 1), at(rows, k, 2));
      color.setXYZ(2 * e + end, paint.r, paint.g, paint.b);
    });
  });
  position.needsUpdate = true;
  color.needsUpdate = true;
}

// Build the routes of all drones: segments from stop to stop. A leg holds the index of the drone, the first vertex of its
// route, and the number of its segments.
function showRoutes(told) {
  const text = JSON.stringify(told);
  if (text === routed) return;
  routed = text;
  seen.routes = told;
  const ends = [];
  legs = [];
  seen.about.ids.forEach((i, k) => {
    const stops = told[i] ?? [];
    if (stops.length) legs.push({ k, first: ends.length / 3, count: stops.length });
    stops.forEach((stop, s) => ends.push(...(stops[s - 1] ?? stop), ...stop));
  });
  routes.geometry.dispose();
  routes.geometry = new THREE.BufferGeometry();
  for (const name of ["position", "color"]) routes.geometry.setAttribute(name, new THREE.Float32BufferAttribute(ends, 3));
  unbounded(routes);
  soon();
}

// Move the start of each route to its drone, and give the route the colour of the drone.
function leave(about, rows, repaint) {
  const { position, color } = routes.geometry.attributes;
  for (const { k, first, count } of legs) {
    position.setXYZ(first, at(rows, k, 0), at(rows, k, 1), at(rows, k, 2));
    paint.set(tint(about.ids[k], k, rows));
    for (let end = first; repaint && end < first + 2 * count; end++) color.setXYZ(end, paint.r, paint.g, paint.b);
  }
  routes.computeLineDistances();
  position.needsUpdate = true;
  color.needsUpdate = true;
}

export function showPaths(paths) {
  const ends = paths.flatMap((points) => points.slice(1).flatMap((point, k) => [...points[k], ...point]));
  path.geometry.dispose();
  path.geometry = new THREE.BufferGeometry();
  path.geometry.setAttribute("position", new THREE.Float32BufferAttribute(ends, 3));
  unbounded(path);
}

// Colours of the tasks, by fate.
const FATE_COLOURS = { open: "--warn", aboard: "--accent", delivered: "--good", done: "--good", cancelled: "--faint", lost: "--bad" };

function showTasks(list) {
  const text = JSON.stringify(list);
  if (text === tasked) return;
  tasked = text;
  tasks.clear();
  if (!list) return;
  const z = seen.about.ground + 0.02;
  for (const task of list) {
    const spots = task.delivery ? [task.pickup, task.delivery] : [task.pickup];
    const material = new THREE.MeshBasicMaterial({ color: colour(FATE_COLOURS[task.fate] ?? "--warn") });
    spots.forEach((spot, end) => {
      const shape = end ? new THREE.BoxGeometry(0.14, 0.14, 0.02) : new THREE.CylinderGeometry(0.08, 0.08, 0.02).rotateX(Math.PI / 2);
      const mark = new THREE.Mesh(shape, material);
      mark.position.set(...spot, z);
      const name = label(String(task.id), 0.35);
      name.position.set(spot[0], spot[1], z + 0.15);
      tasks.add(mark, ...(list.length <= MAX_LABELS ? [name] : []));
    });
    if (spots.length > 1) {
      const shape = new THREE.BufferGeometry().setFromPoints(spots.map((spot) => new THREE.Vector3(...spot, z)));
      tasks.add(new THREE.Line(shape, new THREE.LineBasicMaterial({ color: material.color })));
    }
  }
}

// Return the point of the floor at the pointer, (2,) m; null if there is none.
function floor(event) {
  const area = renderer.domElement.getBoundingClientRect();
  const x = (2 * (event.clientX - area.left)) / area.width - 1;
  const y = 1 - (2 * (event.clientY - area.top)) / area.height;
  const ray = new THREE.Raycaster();
  ray.setFromCamera(new THREE.Vector2(x, y), camera);
  const hit = ray.ray.intersectPlane(new THREE.Plane(new THREE.Vector3(0, 0, 1), -seen.about.ground), new THREE.Vector3());
  return hit && [Math.round(100 * hit.x) / 100, Math.round(100 * hit.y) / 100];
}

export function start(element) {
  host = element;
  renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
  renderer.domElement.setAttribute("role", "img");
  renderer.domElement.setAttribute("aria-label", SCENE_TEXT);
  host.append(renderer.domElement);
  scene = new THREE.Scene();
  camera = new THREE.PerspectiveCamera(50, 1, 0.05, 500);
  camera.up.set(0, 0, 1);
  controls = new OrbitControls(camera, renderer.domElement);
  controls.addEventListener("change", soon);
  let pressed = null;
  renderer.domElement.addEventListener("pointerdown", (event) => (pressed = [event.clientX, event.clientY]));
  renderer.domElement.addEventListener("pointerup", (event) => {
    const still = pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < 5;
    const spot = still && seen.about && floor(event);
    if (spot) tell("floor", spot);
  });
  new ResizeObserver(() => {
    const { clientWidth, clientHeight } = host;
    if (!clientWidth || !clientHeight) return;
    renderer.setSize(clientWidth, clientHeight);
    camera.aspect = clientWidth / clientHeight;
    camera.updateProjectionMatrix();
    soon();
  }).observe(host);
  on("about", build);
  on("frame", soon);
  on("tasks", showTasks);
  on("routes", showRoutes);
  on("theme", () => seen.about && build(seen.about));
  if (seen.about) build(seen.about);
}
