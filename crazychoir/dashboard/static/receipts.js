// Receipts of commands: all in a list, the newest in the header, where every tab shows it, with what has gone wrong; and
// what this page has asked for, until its server says so. Of stops in the header: see stops.js.
import { on } from "./line.js";
import { make, set } from "./table.js";

const ANSWER = 1000; // ms within which the server shows a receipt of what it was asked for
export const STOP = "emergency stop";
const CLEAR = "clear stop";
const VERBS = { "go-to": "go-to", fly: "fly", impair: "impair", "add-task": "task_add", "cancel-task": "task_cancel" };
const MARKS = { done: "✓", bad: "✗", open: "…", over: "–" };
const find = (id) => document.getElementById(id);
let newest = 0, troubled = 0; // numbers of receipts
let raised = ""; // the last trouble of a receipt: told once
let frames = 0; // on this line; what comes before the second may be long ago
let waiting = []; // what was asked for and has no receipt yet, oldest first

export const among = (ids) => (ids.length > 8 ? `${ids.length} drones` : ids.join(", "));

function words(answers) {
  const groups = {};
  for (const [i, [kind, said]] of Object.entries(answers)) {
    const text = typeof said === "string" ? said : said.id == null ? "" : `task ${said.id}${said.note ? `: ${said.note}` : ""}`;
    const long = text.length > 90 ? `${text.slice(0, 87)}...` : text;
    (groups[kind + (long ? `: ${long}` : "")] ??= []).push(i);
  }
  return Object.entries(groups).map(([said, ids]) => `${among(ids)} ${said}`).join("; ");
}

const isBad = ([kind]) => ["refused", "silent", "unfinished"].includes(kind);
const bad = ({ answers }) => Object.fromEntries(Object.entries(answers).filter(([, answer]) => isBad(answer)));

function outcome({ answers }) {
  const all = Object.values(answers);
  if (all.some(isBad)) return "bad";
  if (all.some(([kind]) => kind === "sent" || kind === "accepted")) return "open";
  return all.every(([kind]) => kind === "done") ? "done" : "over";
}

export function told(receipt, answers) {
  return `${MARKS[outcome(receipt)]} ${receipt.verb} ${receipt.words} → ${words(answers)}`.replace("  ", " ");
}

// Until something else is commanded, or it is mended; number: of its receipt, -1 while one is missing, 0 of a refusal.
function trouble(text, number = 0) {
  troubled = number;
  set(find("trouble"), text);
}

function verbOf({ ask, verb, clear }) {
  if (ask === "stop") return clear ? CLEAR : STOP;
  return ask === "order" ? verb : VERBS[ask];
}

function asked(message) {
  const verb = verbOf(message);
  if (verb || !troubled) trouble("");
  if (!verb) return; // a drawing or a file, of which its own tab tells
  waiting = waiting.filter(({ late }) => !late);
  const one = { verb, late: false, timer: setTimeout(() => doubt([one]), ANSWER) };
  waiting.push(one);
  set(find("newest"), `${MARKS.open} ${verb}: sent`);
}

function doubt(ones) {
  for (const one of ones) one.late = true;
  const verbs = [...new Set(waiting.filter(({ late }) => late).map(({ verb }) => verb))].join(", ");
  if (verbs) trouble(`${MARKS.bad} ${verbs}: no answer of this page's server; drones may not have heard it`, -1);
}

function answered(is) {
  const k = waiting.findIndex(({ verb }) => is(verb));
  if (k < 0) return;
  clearTimeout(waiting.splice(k, 1)[0].timer);
  if (troubled < 0 && !waiting.some(({ late }) => late)) trouble("");
}

function list(items, receipt) {
  const id = `receipt-${receipt.number}`;
  let item = find(id);
  if (!item) {
    item = make("li", { id });
    items.prepend(item);
  }
  item.dataset.outcome = outcome(receipt);
  set(item, told(receipt, receipt.answers));
}

function head(receipt) {
  const { number, verb } = receipt, wrong = told(receipt, bad(receipt));
  if (outcome(receipt) !== "bad") {
    if (troubled === number) trouble("");
  } else if (verb !== STOP && frames > 1 && raised !== number + wrong) {
    raised = number + wrong;
    trouble(wrong, number);
  }
  if (number === newest) set(find("newest"), verb === STOP ? "" : told(receipt, receipt.answers));
}

function receipts(items, changed) {
  for (const receipt of changed) {
    if (receipt.number > newest) {
      newest = receipt.number;
      answered((verb) => verb === receipt.verb);
    }
    list(items, receipt);
    head(receipt);
  }
  while (items.children.length > 30) items.lastChild.remove();
}

// All receipts that there are come on a new line.
function anew(items) {
  items.replaceChildren();
  newest = frames = 0;
  set(find("newest"), "");
}

function lost() {
  doubt(waiting);
  for (const { timer } of waiting) clearTimeout(timer);
  waiting = [];
  set(find("newest"), "This page shows nothing new; a stop waits for the line.");
}

export function start() {
  const items = find("receipts");
  on("about", () => anew(items));
  on("frame", () => (frames += 1));
  on("receipts", (changed) => receipts(items, changed));
  on("asked", asked);
  on("connected", (there) => there || lost());
  on("refused", (why) => {
    answered((verb) => verb !== STOP);
    set(find("newest"), "");
    trouble(`${MARKS.bad} ${why}`);
    items.prepend(make("li", { "data-outcome": "bad" }, `${MARKS.bad} ${why}`));
  });
}
