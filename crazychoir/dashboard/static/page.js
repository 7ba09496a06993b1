// Start all parts of the page. The space key stops all drones, unless the focus is in a text field.
import { ask, chosen, connect, on, seen, select, tell } from "./line.js";
import { number, numbers } from "./canvas.js";
import * as draw from "./draw.js";
import * as hints from "./hints.js";
import * as log from "./log.js";
import * as parameters from "./parameters.js";
import * as plots from "./plots.js";
import * as receipts from "./receipts.js";
import * as stick from "./stick.js";
import * as stops from "./stops.js";
import * as swarmPlots from "./swarm_plots.js";
import * as table from "./table.js";
import { make, set } from "./table.js";
import * as tasks from "./tasks.js";

const find = (id) => document.getElementById(id);

function tabs() {
  const all = [...document.querySelectorAll('[role="tab"]')];
  const show = (tab) => {
    for (const other of all) {
      const isShown = other === tab;
      other.setAttribute("aria-selected", isShown);
      other.tabIndex = isShown ? 0 : -1;
      find(other.getAttribute("aria-controls")).hidden = !isShown;
    }
    tell("tab", tab.getAttribute("aria-controls"));
  };
  all.forEach((tab, k) => {
    tab.addEventListener("click", () => show(tab));
    tab.addEventListener("keydown", ({ key }) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[key];
      if (!step) return;
      const next = all[(k + step + all.length) % all.length];
      next.focus();
      show(next);
    });
  });
  show(all.find((tab) => !find(tab.getAttribute("aria-controls")).hidden));
}

const TEXT_TYPES = ["text", "search", "password", "email", "url"]; // types of input elements
const writes = (element) => element.isContentEditable || element.tagName === "TEXTAREA" || TEXT_TYPES.includes(element.type);

// Return the loss (share) and the delay (s) that the simulated network gives the links of the selected drones.
// rules: as Impairment.describe returns them; a rule for a link overrides a rule for a drone, which overrides a general rule
function simulated(rules, drones) {
  const covers = ({ drone, edge, directed }) => {
    if (drone != null) return drones?.includes(drone);
    return !edge || (!directed && drones?.length === 2 && edge.every((i) => drones.includes(i)));
  };
  const rank = ({ drone, edge }) => {
    if (edge) return 2;
    return drone != null ? 1 : 0;
  };
  let effects = {};
  for (const rule of rules.filter(covers).sort((one, other) => rank(one) - rank(other))) {
    if ("loss" in rule || "p_good_bad" in rule) { // a new model of loss replaces the old one as a whole
      effects = { delay: effects.delay };
    }
    Object.assign(effects, rule);
  }
  const { loss, delay, p_good_bad: worse, p_bad_good: better } = effects;
  return { loss: loss ?? (worse ? worse / (worse + better) : 0), delay: delay ?? 0 };
}

let network = ""; // the newest rules of the simulated network, as JSON

function slide({ loss, delay }) {
  for (const [id, value] of [["loss", 100 * loss], ["delay", 1000 * delay]]) {
    find(id).value = value;
    find(id).dispatchEvent(new Event("input"));
  }
}

// Show the rules in force. Move the sliders only when the rules have changed, so that news do not undo a setting that the
// operator has not applied yet.
function inForce(told) {
  find("network-said").textContent = told?.words ?? "not known yet";
  const text = JSON.stringify(told?.rules ?? []);
  if (text === network) return;
  network = text;
  slide(simulated(JSON.parse(network), chosen()));
}

// Functions that the buttons call as `window.choir`.
const choir = {
  order: (verb) => ask({ ask: "order", verb, drones: chosen() }),
  stopAll: () => {
    stops.press(null);
    find("clear").close("no");
  },
  stopChosen: () => (chosen() ? stops.press(chosen()) : tell("refused", "motors off: choose drones, or stop all")),
  clearStop: () => {
    find("clear").returnValue = "no";
    find("clear").show();
  },
  goTo: () => {
    if (!chosen()) return tell("refused", "go to: choose drones in the table");
    const values = numbers("goal_x", "goal_y", "goal_z", "apart_y");
    if (values) ask({ ask: "go-to", drones: chosen(), p: values.slice(0, 3), offset: [0, values[3], 0] });
  },
  turn: () => Quasar.Dark.toggle(),
  network: {
    cut: () => (chosen() ? ask({ ask: "impair", drones: chosen(), cut: true }) : tell("refused", "cut off: choose drones")),
    apply: () => ask({ ask: "impair", loss: number("loss") / 100, delay: number("delay") / 1000, drones: chosen() }),
    clear: () => ask({ ask: "impair", clear: true }) && slide(simulated([])),
  },
  sketch: draw.sketch,
  tasks: tasks.tasks,
  parameters: parameters.parameters,
  ask, chosen, seen, select,
};

function sliders() {
  for (const range of document.querySelectorAll('input[type="range"]')) {
    const shown = document.querySelector(`output[for="${range.id}"]`);
    const show = () => (shown.textContent = range.value);
    range.addEventListener("input", show);
    show();
  }
  on("network", inForce);
  on("selected", () => slide(simulated(JSON.parse(network || "[]"), chosen())));
}

function keys() {
  const isStop = (event) => event.code === "Space" && !writes(event.target);
  window.addEventListener("keydown", (event) => {
    if (!isStop(event)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) choir.stopAll();
  }, true);
  window.addEventListener("keyup", (event) => isStop(event) && event.preventDefault(), true);
}

// Prepare the dialog that clears a stop. It is not modal, so STOP ALL can be clicked while it is open.
function dialog() {
  const clear = find("clear");
  clear.addEventListener("close", () => clear.returnValue === "yes" && ask({ ask: "stop", clear: true }));
  clear.addEventListener("keydown", ({ key }) => key === "Escape" && clear.close("no"));
}

function theme() {
  const told = () => requestAnimationFrame(() => tell("theme"));
  new MutationObserver(told).observe(document.body, { attributeFilter: ["class"] });
}

// Wait for the widgets of the page, because they are created after this file is loaded.
export function start() {
  if (find("drones")) begin();
  else setTimeout(start, 20);
}

function begin() {
  window.choir = choir;
  tabs();
  keys();
  sliders();
  dialog();
  theme();
  table.start({ table: find("drones"), caption: find("chosen") });
  on("connected", (there) => {
    if (!find("connection").querySelector("a") || there) set(find("connection"), there ? "connected" : "NOT CONNECTED");
    find("connection").dataset.there = there;
    document.body.toggleAttribute("data-lost", !there);
  });
  on("ended", (why) => {
    set(find("connection"), why || "connected");
    find("connection").toggleAttribute("data-ended", Boolean(why));
  });
  on("locked", () => find("connection").querySelector("a") || find("connection").replaceChildren(make("a", { href: "/" }, "LOG IN AGAIN")));
  on("links", (lost) => (seen.links = lost));
  for (const part of [hints, log, stops, receipts, draw, swarmPlots, plots, tasks, stick, parameters]) part.start();
  connect();
  showRoom();
}

// Load the scene last, because it is the largest part. Without WebGL the rest of the page works all the same.
async function showRoom() {
  try {
    const scene = await import("./scene.js");
    scene.start(find("scene"));
  } catch (error) {
    console.error(error);
    set(find("scene"), `The room cannot be shown: ${error.message}`);
  }
}
