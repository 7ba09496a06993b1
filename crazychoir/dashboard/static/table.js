// Show the drones in a table with a box to select each.
import { chosen, nameOf, on, select, selected } from "./line.js";

const LOSS_TITLE = "share of the drone's messages to other drones that the simulated network has lost; not measured on a real network";
const RADIO_TITLE = "radio link, signal strength, and share of radio packets that the drone has answered, all measured";
const MAX_LISTED_SELECTION = 12; // of a longer selection only the number is shown
// Each column: its name, its text for a drone, and its explanation.
const TABLE_COLUMNS = [
  ["drone", (d) => nameOf(d.id)], ["phase", (d) => (d.heard ? d.phase : "not heard")], ["task", (d) => d.task],
  ["battery", (d) => unit(d.battery, "V")], ["latency", (d) => (d.latency == null ? "" : `${Math.round(1000 * d.latency)} ms`)],
  ["radio", radio, RADIO_TITLE], ["simulated loss", (d) => `${Math.round(100 * d.lost)} %`, LOSS_TITLE],
  ["pose age", (d) => unit(d.age, "s")], ["round", (d) => d.round], ["cost", (d) => d.cost ?? ""],
  ["runs at", (d) => `${d.host} ${d.process}`], ["note", (d) => d.note],
];
const unit = (value, name) => (value == null ? "" : `${value} ${name}`);
const rows = new Map();
let body;

function radio({ link, silent, rssi, answered }) {
  if (silent != null) return `silent for ${Math.round(silent)} s`;
  const measured = [rssi == null ? "" : `${rssi} dBm`, answered == null ? "" : `${Math.round(100 * answered)} % answered`];
  return [link, ...measured].filter(Boolean).join(", ");
}

export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

export function set(element, text) {
  const value = String(text ?? "");
  if (element.textContent !== value) element.textContent = value;
}

function build(table, about) {
  const all = make("input", { type: "checkbox", "aria-label": "all drones" });
  all.addEventListener("change", () => select(all.checked ? about.ids : []));
  const heads = TABLE_COLUMNS.map(([name, , title]) => make("th", { scope: "col", ...(title && { title }) }, name));
  const head = make("tr", {}, make("th", { scope: "col" }, all), ...heads);
  body = make("tbody");
  rows.clear();
  for (const i of about.ids) {
    const box = make("input", { type: "checkbox", "aria-label": `drone ${nameOf(i)}` });
    box.addEventListener("change", () => select(box.checked ? [...selected, i] : [...selected].filter((j) => j !== i)));
    const cells = TABLE_COLUMNS.map(([name], c) => make(c ? "td" : "th", c ? { "data-of": name } : { scope: "row" }));
    const row = make("tr", { "data-drone": i }, make("td", {}, box), ...cells);
    rows.set(i, { row, box, cells });
    body.append(row);
  }
  table.replaceChildren(make("caption", {}, "Drones; select the drones that commands address; none means all"), make("thead", {}, head), body);
  select([...selected].filter((i) => about.ids.includes(i)));
}

function fill(drones) {
  for (const drone of drones) {
    const { row, cells } = rows.get(drone.id) ?? {};
    if (!row) continue;
    row.dataset.phase = drone.heard ? drone.phase : "not heard";
    TABLE_COLUMNS.forEach(([, text], c) => set(cells[c], text(drone)));
  }
}

export function start({ table, caption }) {
  on("about", (about) => build(table, about));
  on("drones", fill);
  on("selected", (ids) => {
    for (const [i, { box, row }] of rows) {
      box.checked = selected.has(i);
      row.toggleAttribute("data-selected", box.checked);
    }
    if (!ids) set(caption, "for all drones");
    else if (ids.length > MAX_LISTED_SELECTION) set(caption, `for ${ids.length} drones`);
    else set(caption, `for drone ${ids.map(nameOf).join(", ")}`);
  });
  set(caption, chosen() ?? "for all drones");
}
