// Stops: one that was pressed is kept until its receipt comes, and sent first on a new line; and the header's line of those
// in force: what drones say, wherever they were stopped from, and who has not obeyed a stop of this server yet.
import { ask, isOpen, on, seen, send } from "./line.js";
import { STOP, among, told } from "./receipts.js";
import { set } from "./table.js";

const LOOK = 250, AGAIN = 1000; // ms between two looks; between two times that a stop is sent on a line
// ms: thrice what a new line takes. Later, somebody else may have stopped and cleared, and drones may have taken off anew.
const OLD = 30000;
const LINGERS = 4; // tables of drones: until then they say themselves what they have obeyed
const find = (id) => document.getElementById(id);
const kept = new Map(); // by key: drones (null: all), when it was pressed and sent, on which line
const open = new Map(); // receipts, by number: those that some have not obeyed, or all have just now
let lines = 0, connected = false;

// The server takes a key once: a stop that is sent again does not stop who was cleared meanwhile.
export function press(drones) {
  if (!drones) kept.clear(); // it is for theirs, too
  const key = `${Date.now().toString(36)}-${Math.random().toString(36).slice(2)}`;
  kept.set(key, { drones, pressed: Date.now(), sent: 0, line: 0 });
  look();
}

const isOld = ({ pressed }) => Date.now() - pressed > OLD;

function sendKept() {
  if (!isOpen()) return;
  for (const [key, one] of kept) {
    if (isOld(one) || (one.line === lines && Date.now() - one.sent < AGAIN)) continue;
    const message = { ask: "stop", key, ...(one.drones && { drones: one.drones }) };
    if (one.line === lines) send(JSON.stringify(message));
    else ask(message);
    one.sent = Date.now();
    one.line = lines;
  }
}

function look() {
  sendKept();
  const ones = [...kept.values()], old = ones.filter(isOld);
  const who = (these) => (these.some(({ drones }) => !drones) ? "ALL" : [...new Set(these.flatMap(({ drones }) => drones))].join(", "));
  if (old.length) say(`STOP ${who(old)}, more than ${OLD / 1000} s ago: no drone has answered. Send it now?`);
  else if (ones.length && !(connected && isOpen())) say(`STOP ${who(ones)}: will be sent when connected`);
  else if (ones.some(({ pressed }) => Date.now() - pressed > AGAIN)) say(`STOP ${who(ones)}: sent again until it is answered`);
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
    if (receipt.verb !== STOP) continue;
    const late = Object.values(receipt.answers).some(([kind]) => kind === "sent" || kind === "silent");
    if (late || open.has(receipt.number)) open.set(receipt.number, { receipt, looks: late ? Infinity : LINGERS });
  }
  look();
  inForce();
}

function inForce() {
  const heard = seen.drones.filter((drone) => drone.heard), ids = (which) => heard.filter(which).map(({ id }) => id);
  const held = ids(({ stopped }) => stopped), off = ids(({ phase }) => phase === "stopped"), parts = [];
  if (held.length) parts.push(`emergency stop of the swarm in force: ${among(held)} may not take off`);
  if (off.length) parts.push(`motors off: ${among(off)}`);
  for (const { receipt } of open.values()) parts.push(told(receipt, receipt.answers));
  set(find("stopped"), parts.join(" · "));
}

function drones() {
  for (const [number, one] of open) if (--one.looks < 0) open.delete(number);
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
    for (const one of kept.values()) one.pressed = Date.now();
    look();
  });
  setInterval(look, LOOK);
}
