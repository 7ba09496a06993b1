// Show the receipts of commands: all in a list; the newest, and the last failure, in the header above every tab. Show a
// command of this page as sent until the server returns its receipt. stops.js shows the stops in the header.
import { nameOf, on } from "./line.js";
import { make, set } from "./table.js";

const ANSWER_TIMEOUT = 1000; // ms from a command until the server must have returned a receipt
const MAX_NAMED_DRONES = 8; // of a longer list only the number is shown
const MAX_TEXT_LENGTH = 90; // characters of an answer
const MAX_RECEIPTS = 30; // in the list
export const STOP_VERB = "emergency stop";
const CLEAR_VERB = "clear stop";
const VERB_NAMES = { "go-to": "go-to", fly: "fly", impair: "impair", "add-task": "task_add", "cancel-task": "task_cancel", "set-parameter": "firmware_set" };
const OUTCOME_MARKS = { done: "✓", bad: "✗", open: "…", over: "–" };
const find = (id) => document.getElementById(id);
let newest = 0; // number of the newest receipt
let troubled = 0; // number of the receipt with the failure that is shown; see trouble()
let raised = ""; // the failure of a receipt that was shown last: each is shown once
let frames = 0; // on this line; a receipt before the second frame may be old
let waiting = []; // commands without a receipt, oldest first

export const among = (ids) => (ids.length > MAX_NAMED_DRONES ? `${ids.length} drones` : ids.map(nameOf).join(", "));

// Return the text of an answer.
function textOf(said) {
  if (typeof said === "string") return said;
  if (said.id == null) return "";
  return said.note ? `task ${said.id}: ${said.note}` : `task ${said.id}`;
}

// Return the answers as text; drones with the same answer are named together.
function words(answers) {
  const groups = {};
  for (const [i, [kind, said]] of Object.entries(answers)) {
    const text = textOf(said);
    const long = text.length > MAX_TEXT_LENGTH ? `${text.slice(0, MAX_TEXT_LENGTH - 3)}...` : text;
    const group = long ? `${kind}: ${long}` : kind;
    (groups[group] ??= []).push(i);
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
  return `${OUTCOME_MARKS[outcome(receipt)]} ${receipt.verb} ${receipt.words} → ${words(answers)}`.replace("  ", " ");
}

// Show a failure until the next command, or until the failure is resolved.
// number: the number of the receipt; -1 if the receipt is missing; 0 if the page or the server has refused the command
function trouble(text, number = 0) {
  troubled = number;
  set(find("trouble"), text);
}

function verbOf({ ask, verb, clear }) {
  if (ask === "stop") return clear ? CLEAR_VERB : STOP_VERB;
  return ask === "order" ? verb : VERB_NAMES[ask];
}

function asked(message) {
  const verb = verbOf(message);
  if (verb || !troubled) trouble("");
  if (!verb) return; // a drawing or a file: its own tab shows the result
  waiting = waiting.filter(({ late }) => !late);
  const command = { verb, late: false, timer: setTimeout(() => doubt([command]), ANSWER_TIMEOUT) };
  waiting.push(command);
  set(find("newest"), `${OUTCOME_MARKS.open} ${verb}: sent`);
}

// Report that these commands have no receipt in time.
function doubt(commands) {
  for (const command of commands) command.late = true;
  const verbs = [...new Set(waiting.filter(({ late }) => late).map(({ verb }) => verb))].join(", ");
  if (verbs) trouble(`${OUTCOME_MARKS.bad} ${verbs}: no answer of this page's server; the drones may not have received it`, -1);
}

// Remove the oldest waiting command with such a verb.
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
  const { number, verb } = receipt;
  const wrong = told(receipt, bad(receipt));
  if (outcome(receipt) !== "bad") {
    if (troubled === number) trouble("");
  } else if (verb !== STOP_VERB && frames > 1 && raised !== number + wrong) {
    raised = number + wrong;
    trouble(wrong, number);
  }
  if (number === newest) set(find("newest"), verb === STOP_VERB ? "" : told(receipt, receipt.answers));
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
  while (items.children.length > MAX_RECEIPTS) items.lastChild.remove();
}

// Clear the list: the server sends all receipts again on a new line.
function anew(items) {
  items.replaceChildren();
  newest = 0;
  frames = 0;
  set(find("newest"), "");
}

function lost() {
  doubt(waiting);
  for (const { timer } of waiting) clearTimeout(timer);
  waiting = [];
  set(find("newest"), "No new data; a stop is sent when connected again.");
}

export function start() {
  const items = find("receipts");
  on("about", () => anew(items));
  on("frame", () => (frames += 1));
  on("receipts", (changed) => receipts(items, changed));
  on("asked", asked);
  on("connected", (there) => there || lost());
  on("refused", (why) => {
    answered((verb) => verb !== STOP_VERB);
    set(find("newest"), "");
    trouble(`${OUTCOME_MARKS.bad} ${why}`);
    items.prepend(make("li", { "data-outcome": "bad" }, `${OUTCOME_MARKS.bad} ${why}`));
  });
}
