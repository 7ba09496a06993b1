// Keep each stop that the operator presses until its receipt arrives, and send it first on a new line. Show in the header the
// stops in force, as the drones report them, and the drones that have not obeyed a stop of this server yet.
import { ask, isOpen, nameOf, on, seen, send } from "./line.js";
import { STOP_VERB, among, told } from "./receipts.js";
import { set } from "./table.js";

const LOOK_PERIOD = 250; // ms between two checks of the kept stops
const RESEND_PERIOD = 1000; // ms between two sendings of a stop on the same line
// Three times as long as a new line takes. After a longer time another operator may have stopped the drones and cleared the
// stop, and the drones may fly again: the page then asks before it sends the stop.
const MAX_STOP_AGE = 30000; // ms
const LINGER_TABLES = 4; // tables of drones for which an obeyed stop is still shown; by then the drones report it themselves
const find = (id) => document.getElementById(id);
const kept = new Map(); // by key: drones (null: all), ms when the stop was pressed and sent, number of the line
const open = new Map(); // receipts by number: stops that a drone has not obeyed yet, or that were obeyed just now
let lines = 0; // opened by this page
let connected = false;

// Keep and send a stop. The server accepts each key once, so a stop that is sent again does not stop drones that were cleared
// in between.
export function press(drones) {
  if (!drones) kept.clear(); // a stop of all drones includes the kept stops
  const key = `${Date.now().toString(36)}-${Math.random().toString(36).slice(2)}`;
  kept.set(key, { drones, pressed: Date.now(), sent: 0, line: 0 });
  look();
}

const isOld = ({ pressed }) => Date.now() - pressed > MAX_STOP_AGE;

function sendKept() {
  if (!isOpen()) return;
  for (const [key, stop] of kept) {
    const isJustSent = stop.line === lines && Date.now() - stop.sent < RESEND_PERIOD;
    if (isOld(stop) || isJustSent) continue;
    const message = { ask: "stop", key, ...(stop.drones && { drones: stop.drones }) };
    if (stop.line === lines) send(JSON.stringify(message));
    else ask(message);
    stop.sent = Date.now();
    stop.line = lines;
  }
}

// Return the drones that these stops address, as text.
function names(stops) {
  if (stops.some(({ drones }) => !drones)) return "ALL";
  return [...new Set(stops.flatMap(({ drones }) => drones))].map(nameOf).join(", ");
}

// Send the kept stops, and show in the header what they wait for.
function look() {
  sendKept();
  const stops = [...kept.values()];
  const old = stops.filter(isOld);
  if (old.length) say(`STOP ${names(old)}, more than ${MAX_STOP_AGE / 1000} s ago: no drone has answered. Send it now?`);
  else if (stops.length && !(connected && isOpen())) say(`STOP ${names(stops)}: will be sent when connected`);
  else if (stops.some(({ pressed }) => Date.now() - pressed > RESEND_PERIOD)) say(`STOP ${names(stops)}: sent again until it is answered`);
  else say("");
  find("kept-send").hidden = !old.length;
}

function say(text) {
  set(find("kept-said"), text);
  find("kept").hidden = !text;
}

function receipts(changed) {
  for (const receipt of changed) {
    if (receipt.key) kept.delete(receipt.key);
    if (receipt.verb !== STOP_VERB) continue;
    const late = Object.values(receipt.answers).some(([kind]) => kind === "sent" || kind === "silent");
    if (late || open.has(receipt.number)) open.set(receipt.number, { receipt, looks: late ? Infinity : LINGER_TABLES });
  }
  look();
  inForce();
}

// Show the stops in force.
function inForce() {
  const heard = seen.drones.filter((drone) => drone.heard);
  const ids = (which) => heard.filter(which).map(({ id }) => id);
  const held = ids(({ stopped }) => stopped);
  const off = ids(({ phase }) => phase === "stopped");
  const parts = [];
  if (held.length) parts.push(`emergency stop of the swarm in force: ${among(held)} may not take off`);
  if (off.length) parts.push(`motors off: ${among(off)}`);
  for (const { receipt } of open.values()) parts.push(told(receipt, receipt.answers));
  set(find("stopped"), parts.join(" · "));
}

function drones() {
  for (const [number, shown] of open) {
    shown.looks -= 1;
    if (shown.looks < 0) open.delete(number);
  }
  inForce();
}

export function start() {
  on("opened", () => {
    lines += 1;
    sendKept();
  });
  on("connected", (there) => {
    connected = there;
    look();
  });
  on("asked", ({ ask, clear }) => ask === "stop" && clear && kept.clear());
  on("about", () => open.clear());
  on("receipts", receipts);
  on("drones", drones);
  find("kept-withdraw").addEventListener("click", () => {
    kept.clear();
    look();
  });
  find("kept-send").addEventListener("click", () => {
    for (const stop of kept.values()) stop.pressed = Date.now();
    look();
  });
  setInterval(look, LOOK_PERIOD);
}
