// The page, put together. Space stops all, wherever the focus is but in a text.
import { ask, chosen, connect, on, seen, select, tell } from "./line.js";
import { number, numbers } from "./canvas.js";
import * as draw from "./draw.js";
import * as plots from "./plots.js";
import * as receipts from "./receipts.js";
import * as scene from "./scene.js";
import * as stops from "./stops.js";
import * as table from "./table.js";
import * as tasks from "./tasks.js";

const find = (id) => document.getElementById(id);

function tabs() {
  const all = [...document.querySelectorAll('[role="tab"]')];
  const show = (tab) => {
    for (const one of all) {
      const chosen = one === tab;
      one.setAttribute("aria-selected", chosen);
      one.tabIndex = chosen ? 0 : -1;
      find(one.getAttribute("aria-controls")).hidden = !chosen;
    }
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
  show(all[0]);
}

const TEXTS = ["text", "search", "password", "email", "url"];
const writes = (element) => element.isContentEditable || element.tagName === "TEXTAREA" || TEXTS.includes(element.type);

const SETTLED = 200; // ms: an arrow key that is held changes a slider 31 times a second
const settling = {};

// What buttons call.
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
    clear: () => {
      for (const id in settling) clearTimeout(settling[id]);
      return ask({ ask: "impair", clear: true });
    },
  },
  sketch: draw.sketch,
  tasks: tasks.tasks,
  ask, chosen, seen, select,
};

function sliders() {
  for (const range of document.querySelectorAll('input[type="range"]')) {
    const shown = document.querySelector(`output[for="${range.id}"]`);
    const show = () => (shown.textContent = range.value);
    range.addEventListener("input", show);
    show();
  }
  for (const [id, unit] of [["loss", 100], ["delay", 1000]]) {
    find(id).addEventListener("change", () => {
      const message = { ask: "impair", [id]: number(id) / unit, drones: chosen() };
      clearTimeout(settling[id]);
      settling[id] = setTimeout(() => ask(message), SETTLED);
    });
  }
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

// Not a modal one: all may be stopped meanwhile, by mouse too.
function dialog() {
  const clear = find("clear");
  clear.addEventListener("close", () => clear.returnValue === "yes" && ask({ ask: "stop", clear: true }));
  clear.addEventListener("keydown", ({ key }) => key === "Escape" && clear.close("no"));
}

function theme() {
  const told = () => requestAnimationFrame(() => tell("theme"));
  new MutationObserver(told).observe(document.body, { attributeFilter: ["class"] });
}

// The page's widgets are made after this file is read.
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
  table.start({ table: find("drones"), lines: find("log"), level: find("level"), caption: find("chosen") });
  on("connected", (there) => {
    find("connection").textContent = there ? "connected" : "NOT CONNECTED: this page shows nothing new; a stop waits";
    find("connection").dataset.there = there;
    document.body.toggleAttribute("data-lost", !there);
  });
  on("links", (lost) => (seen.links = lost));
  for (const part of [stops, receipts, draw, plots, tasks]) part.start();
  scene.start(find("scene"));
  connect();
}
