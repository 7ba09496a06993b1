// Fly one chosen drone by hand: arrow keys on the focused pad, or the sticks of a gamepad while a shoulder button is held.
// While the operator holds something, a velocity is sent at each look; at the release one zero velocity, after which the
// drone rests. Without new velocities the drone stops by itself.
import { ask, chosen, isOpen, nameOf, on, tell } from "./line.js";
import { set } from "./table.js";

const LOOK_PERIOD = 100; // ms between two velocities
const YAW_RATE = 1.0; // rad/s
const DEAD_BUTTONS = [4, 5]; // shoulder buttons of the standard layout: one of them must be held
const STICK_REST = 0.15; // a stick nearer to its centre counts as centred
const KEY_WISHES = {
  ArrowRight: [1, 0, 0, 0], ArrowLeft: [-1, 0, 0, 0],
  ArrowUp: [0, 1, 0, 0], ArrowDown: [0, -1, 0, 0],
  PageUp: [0, 0, 1, 0], PageDown: [0, 0, -1, 0],
  Home: [0, 0, 0, 1], End: [0, 0, 0, -1],
};
const find = (id) => document.getElementById(id);
const held = new Set(); // keys
let flown = null; // id of the drone that flies by hand

const isStill = (wish) => wish.every((part) => part === 0);

const centred = (value) => (Math.abs(value ?? 0) < STICK_REST ? 0 : value);

// Return what the keys ask for: x, y, z, yaw, each -1 to 1.
function wishOfKeys() {
  const wish = [0, 0, 0, 0];
  for (const key of held) KEY_WISHES[key].forEach((part, k) => (wish[k] += part));
  return wish;
}

// Return what the first gamepad with a held shoulder button asks for; null if there is none.
function wishOfGamepad() {
  const pad = [...(navigator.getGamepads?.() ?? [])].find((one) => one && DEAD_BUTTONS.some((k) => one.buttons[k]?.pressed));
  if (!pad) return null;
  const [left, down, turn, sink] = [0, 1, 2, 3].map((k) => centred(pad.axes[k]));
  return [left, -down, -sink, -turn].map((part) => part + 0); // no negative zero
}

function release() {
  if (flown === null) return;
  ask({ ask: "steer", drone: flown, v: [0, 0, 0], yaw_rate: 0 });
  flown = null;
  say("");
}

// Without a line nothing can be sent; the drone stops by itself.
function forget() {
  held.clear();
  flown = null;
  say("");
}

function say(words) {
  set(find("stick-said"), words);
}

// Without focus the browser reports no keys, and an old state of a gamepad.
const isAttended = () => !document.hidden && document.hasFocus();

function look() {
  if (!isOpen()) return forget();
  if (!isAttended()) {
    held.clear();
    return release();
  }
  const wish = wishOfGamepad() ?? wishOfKeys();
  if (isStill(wish)) return release();
  const drones = chosen();
  if (drones?.length !== 1) {
    release();
    held.clear();
    return tell("refused", "fly by hand: choose one drone in the table");
  }
  if (flown !== null && flown !== drones[0]) release();
  flown = drones[0];
  const speed = Number(find("stick_speed").value) || 0;
  const [x, y, z, yaw] = wish;
  ask({ ask: "steer", drone: flown, v: [x * speed, y * speed, z * speed], yaw_rate: yaw * YAW_RATE });
  say(`drone ${nameOf(flown)} flies by hand`);
}

function letGo() {
  held.clear();
  look();
}

// macOS reports no release of a key while Cmd is held; with the other two the keys mean something else.
const isModified = (event) => event.ctrlKey || event.altKey || event.metaKey;

export function start() {
  const pad = find("stick");
  pad.addEventListener("keydown", (event) => {
    if (isModified(event)) return letGo();
    if (!(event.key in KEY_WISHES)) return;
    event.preventDefault();
    if (held.has(event.key)) return;
    held.add(event.key);
    look();
  });
  pad.addEventListener("keyup", (event) => {
    if (isModified(event)) return letGo();
    if (held.delete(event.key)) look();
  });
  pad.addEventListener("blur", letGo);
  window.addEventListener("blur", letGo);
  document.addEventListener("visibilitychange", () => document.hidden && letGo());
  on("selected", () => flown !== null && letGo());
  setInterval(look, LOOK_PERIOD);
}
