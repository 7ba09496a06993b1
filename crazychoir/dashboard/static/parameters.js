// Browse the parameters of the firmware of a drone: list them by groups, read the values of an open group, and set one.
import { ask, nameOf, on, tell } from "./line.js";
import { make, set } from "./table.js";

const MAX_OPENED_GROUPS = 3; // a filter that leaves no more groups opens all of them
const FILTER_DELAY = 250; // ms without a key before the filter is applied
const FLOAT_DIGITS = 7; // of a float32
const COLUMN_NAMES = ["parameter", "type", "access", "value", "new value"];
const find = (id) => document.getElementById(id);
let types = {}; // by name: [type, whether it can be set]
let values = {}; // values that were read, by name
let isAsked = false; // whether the names of this drone were asked for
const drone = () => Number(find("parameter-drone").value);
const said = (text) => set(find("parameters-said"), text);
const groupOf = (name) => name.split(".")[0];
const cell = (name) => document.querySelector(`#parameters td[data-value="${name}"]`);

export const parameters = {
  list: () => {
    types = {};
    values = {};
    isAsked = ask({ ask: "list-parameters", drone: drone() });
    show();
    if (isAsked) said(`Drone ${nameOf(drone())} is asked for its parameters.`);
  },
};

function valueText(name) {
  if (!(name in values)) return "";
  const value = values[name];
  if (value == null) return "not a finite number"; // JSON has no other numbers
  return String(Number.isInteger(value) ? value : Number(value.toPrecision(FLOAT_DIGITS)));
}

function read(name) {
  ask({ ask: "read-parameters", drone: drone(), name });
}

function change(name, input) {
  input.setAttribute("aria-invalid", Number.isNaN(input.valueAsNumber));
  if (Number.isNaN(input.valueAsNumber)) return tell("refused", `${name}: no number; nothing was sent`);
  ask({ ask: "set-parameter", drone: drone(), name, value: input.valueAsNumber });
}

function setter(name) {
  const input = make("input", { type: "number", step: "any", "aria-label": `new value of ${name}` });
  const button = make("button", { type: "button", "aria-label": `Set ${name}` }, "Set");
  input.addEventListener("keydown", ({ key }) => key === "Enter" && change(name, input));
  button.addEventListener("click", () => change(name, input));
  return [input, button];
}

function row(name) {
  const [type, isWritable] = types[name];
  const value = make("td", { "data-value": name }, valueText(name));
  const head = make("th", { scope: "row" }, name.slice(groupOf(name).length + 1));
  const access = make("td", {}, isWritable ? "writable" : "read only");
  return make("tr", {}, head, make("td", {}, type), access, value, make("td", {}, ...(isWritable ? setter(name) : [])));
}

function fill(details, group, names) {
  const again = make("button", { type: "button", "aria-label": `Read ${group} again` }, "Read again");
  again.addEventListener("click", () => read(group));
  const heads = COLUMN_NAMES.map((name) => make("th", { scope: "col" }, name));
  const body = make("tbody", {}, ...names.map(row));
  details.append(again, make("table", {}, make("thead", {}, make("tr", {}, ...heads)), body));
}

function section([group, names], isOpen) {
  const details = make("details", {}, make("summary", {}, `${group} (${names.length})`));
  details.addEventListener("toggle", () => {
    if (!details.open) return;
    if (!details.querySelector("table")) fill(details, group, names);
    if (names.some((name) => !(name in values))) read(group);
  });
  details.open = isOpen;
  return details;
}

// List the groups of the parameters that the filter leaves.
function show() {
  const part = find("parameter-filter").value.trim().toLowerCase();
  const names = Object.keys(types).filter((name) => name.toLowerCase().includes(part));
  const groups = new Map();
  for (const name of names) groups.set(groupOf(name), [...(groups.get(groupOf(name)) ?? []), name]);
  const isNarrow = Boolean(part) && groups.size <= MAX_OPENED_GROUPS;
  find("parameters").replaceChildren(...[...groups].map((group) => section(group, isNarrow)));
  const count = Object.keys(types).length;
  if (count) said(`${names.length} of ${count} parameters`);
}

function answered(told) {
  if (told.drone !== drone()) return;
  if (told.problem) return said(told.problem);
  if (told.types) {
    types = told.types;
    show();
  }
  Object.assign(values, told.values);
  for (const name of Object.keys(told.values ?? {})) {
    if (cell(name)) set(cell(name), valueText(name));
  }
}

export function start() {
  let timer;
  find("parameter-drone").addEventListener("change", parameters.list);
  find("parameter-filter").addEventListener("input", () => {
    clearTimeout(timer);
    timer = setTimeout(show, FILTER_DELAY);
  });
  on("tab", (name) => name === "panel-parameters" && !isAsked && parameters.list());
  on("parameters", answered);
}
