// The line to the server: frames, news, and what this page asks for. It is closed, and opened anew, when no frames come.

export const seen = { about: null, rows: null, at: 0, drones: [], received: 0 };
export const selected = new Set();
const LOOK = 250, QUIET = 4, FIRST = 20; // ms between two looks; so many without a frame: the line is dead, or was never there
const MOST = 1 << 18; // bytes of a message: the server closes the line at a longer one
const listeners = {};
let socket = null;
let again = 0.5;
let quiet = 0;
let there = false;

export function on(kind, listener) {
  (listeners[kind] ??= []).push(listener);
}

export function tell(kind, value) {
  for (const listener of listeners[kind] ?? []) listener(value);
}

function refuse(why) {
  tell("refused", `${why}; nothing was sent: say it again`);
  return false;
}

export const isOpen = () => socket?.readyState === WebSocket.OPEN;

export const send = (text) => socket.send(text);

export function ask(message) {
  if (!isOpen()) return refuse("this page has no line to its server yet");
  const text = JSON.stringify(message), bytes = new Blob([text]).size;
  if (bytes > MOST) return refuse(`${message.ask}: too large, ${Math.ceil(bytes / 1024)} KiB of at most ${MOST / 1024}`);
  send(text);
  tell("asked", message);
  return true;
}

// Null when no drone is selected: then a command is for all.
export function chosen() {
  return selected.size ? [...selected].sort((a, b) => a - b) : null;
}

export function select(ids) {
  selected.clear();
  for (const i of ids) selected.add(i);
  tell("selected", chosen());
}

export function colour(name) {
  return getComputedStyle(document.body).getPropertyValue(name).trim();
}

// The row of drone i in the newest frame: p, v, q, w, age, p of its reference.
export function row(i) {
  if (!seen.rows) return null;
  const k = seen.about.ids.indexOf(i);
  return k < 0 ? null : seen.rows.subarray(k * seen.about.columns, (k + 1) * seen.about.columns);
}

function frame(data) {
  quiet = 0;
  if (!there) {
    there = true;
    again = 0.5;
    tell("connected", true);
  }
  seen.at = new DataView(data).getFloat64(0, true);
  seen.rows = new Float32Array(data, 8);
  seen.received += 1;
  tell("frame", seen);
}

function news(message) {
  for (const [kind, value] of Object.entries(message)) {
    if (kind === "about") seen.about = value;
    if (kind === "drones") seen.drones = value;
    tell(kind, value);
  }
}

function open() {
  const address = new URL("/line", location.href);
  address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  const line = (socket = new WebSocket(address));
  quiet = -FIRST;
  line.binaryType = "arraybuffer";
  line.onmessage = ({ data }) => line === socket && (typeof data === "string" ? news(JSON.parse(data)) : frame(data));
  line.onopen = () => line === socket && tell("opened");
  line.onclose = () => line === socket && lose();
}

// Not by waiting for the other end, which may never answer.
function lose() {
  const line = socket;
  socket = null;
  there = false;
  line.close();
  tell("connected", false);
  locked();
  setTimeout(open, 1000 * again);
  again = Math.min(2 * again, 5);
}

// A password counts for a while only: what a line is refused for, its browser tells nobody.
async function locked() {
  const answer = await fetch("/own/page.css", { cache: "no-store" }).catch(() => null);
  if (answer?.status === 401) tell("locked");
}

// Looks are counted, not seconds: one that comes late, as in a browser that was busy, leaves time for frames that have come.
function look() {
  if (socket && !document.hidden && ++quiet > QUIET) lose();
}

export function connect() {
  document.addEventListener("visibilitychange", () => (quiet = Math.min(quiet, 0)));
  setInterval(look, LOOK);
  open();
}
