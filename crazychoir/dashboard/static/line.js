// The line to the server: frames, news, and what this page asks for.

export const seen = { about: null, rows: null, at: 0, drones: [], received: 0 };
export const selected = new Set();
const listeners = {};
let socket = null;
let again = 0.5;

export function on(kind, listener) {
  (listeners[kind] ??= []).push(listener);
}

export function tell(kind, value) {
  for (const listener of listeners[kind] ?? []) listener(value);
}

export function ask(message) {
  if (socket?.readyState !== WebSocket.OPEN) {
    tell("refused", "not connected: nothing was sent");
    return false;
  }
  socket.send(JSON.stringify(message));
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

export function connect() {
  const address = new URL("/line", location.href);
  address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  socket = new WebSocket(address);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { again = 0.5; tell("connected", true); };
  socket.onmessage = ({ data }) => (typeof data === "string" ? news(JSON.parse(data)) : frame(data));
  socket.onclose = () => {
    tell("connected", false);
    setTimeout(connect, 1000 * again);
    again = Math.min(2 * again, 5);
  };
}
