// The connection to the server (the line): receive frames and news, send requests. When no frames arrive, close the line and
// open a new one.

export const seen = { about: null, rows: null, at: 0, drones: [], received: 0 };
export const selected = new Set();
const LOOK_PERIOD = 250; // ms between two checks of the line
const MAX_QUIET_LOOKS = 4; // checks without a frame before the line counts as lost
const FIRST_FRAME_LOOKS = 20; // further checks that a new line has for its first frame
const MAX_MESSAGE_SIZE = 1 << 18; // bytes, the server closes the line at a longer message
const MIN_RETRY_DELAY = 0.5; // s before the line is opened again
const MAX_RETRY_DELAY = 5; // s
const listeners = {};
let socket = null;
let again = MIN_RETRY_DELAY;
let quiet = 0; // checks since the last frame
let there = false; // whether frames arrive

export function on(kind, listener) {
  (listeners[kind] ??= []).push(listener);
}

export function tell(kind, value) {
  for (const listener of listeners[kind] ?? []) listener(value);
}

function refuse(why) {
  tell("refused", `${why}; nothing was sent: try again`);
  return false;
}

export const isOpen = () => socket?.readyState === WebSocket.OPEN;

export const send = (text) => socket.send(text);

export function ask(message) {
  if (!isOpen()) return refuse("this page is not connected to its server yet");
  const text = JSON.stringify(message);
  const bytes = new Blob([text]).size;
  if (bytes > MAX_MESSAGE_SIZE) return refuse(`${message.ask}: too large, ${Math.ceil(bytes / 1024)} KiB of at most ${MAX_MESSAGE_SIZE / 1024}`);
  send(text);
  tell("asked", message);
  return true;
}

// Return the ids of the selected drones, in order. Return null if no drone is selected: a command then addresses all drones.
export function chosen() {
  return selected.size ? [...selected].sort((a, b) => a - b) : null;
}

// Return the drone i as it is named for people: its id, and its name in the swarm file.
export const nameOf = (i) => seen.about?.names[i] ?? String(i);

export function select(ids) {
  selected.clear();
  for (const i of ids) selected.add(i);
  tell("selected", chosen());
}

export function colour(name) {
  return getComputedStyle(document.body).getPropertyValue(name).trim();
}

// Return the row of drone i in the newest frame: position, velocity, quaternion, body rates, age, and reference position.
export function row(i) {
  if (!seen.rows) return null;
  const k = seen.about.ids.indexOf(i);
  return k < 0 ? null : seen.rows.subarray(k * seen.about.columns, (k + 1) * seen.about.columns);
}

function frame(data) {
  quiet = 0;
  if (!there) {
    there = true;
    again = MIN_RETRY_DELAY;
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
  quiet = -FIRST_FRAME_LOOKS;
  line.binaryType = "arraybuffer";
  line.onmessage = ({ data }) => line === socket && (typeof data === "string" ? news(JSON.parse(data)) : frame(data));
  line.onopen = () => line === socket && tell("opened");
  line.onclose = () => line === socket && lose();
}

// Drop the line at once, because the server may never answer a closing handshake; open a new line after a delay.
function lose() {
  const line = socket;
  socket = null;
  there = false;
  line.close();
  tell("connected", false);
  locked();
  setTimeout(open, 1000 * again);
  again = Math.min(2 * again, MAX_RETRY_DELAY);
}

// Report an expired login. The browser does not tell a page why its WebSocket was refused, so request a file and read the
// status code.
async function locked() {
  const answer = await fetch("/own/page.css", { cache: "no-store" }).catch(() => null);
  if (answer?.status === 401) tell("locked");
}

// Check the line. Count checks instead of seconds: in a busy browser a check runs late, and frames that have already arrived
// are still handled before the next check.
function look() {
  if (!socket || document.hidden) return;
  quiet += 1;
  if (quiet > MAX_QUIET_LOOKS) lose();
}

export function connect() {
  document.addEventListener("visibilitychange", () => (quiet = Math.min(quiet, 0)));
  setInterval(look, LOOK_PERIOD);
  open();
}
