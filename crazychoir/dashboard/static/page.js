// The page, put together. Space stops all, wherever the focus is but in a text.
import { ask, chosen, connect, on, seen, select, tell } from "./line.js";
import * as scene from "./scene.js";
import * as table from "./table.js";

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

const writes = (element) =>
  element.isContentEditable || element.tagName === "TEXTAREA" || (element.tagName === "INPUT" && !["checkbox", "button", "range"].includes(element.type));

export function stopAll() {
  return ask({ ask: "stop" });
}

function keys() {
  const isStop = (event) => event.code === "Space" && !writes(event.target);
  window.addEventListener("keydown", (event) => {
    if (!isStop(event)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) stopAll();
  }, true);
  window.addEventListener("keyup", (event) => isStop(event) && event.preventDefault(), true);
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
  tabs();
  keys();
  theme();
  table.start({ table: find("drones"), said: find("receipts"), lines: find("log"), level: find("level"), caption: find("chosen") });
  on("connected", (there) => {
    find("connection").textContent = there ? "connected" : "NOT CONNECTED: this page shows nothing new, and cannot stop anything";
    find("connection").dataset.there = there;
  });
  on("selected", (ids) => window.emitEvent?.("selected", ids));
  scene.start(find("scene"));
  window.choir = { ask, chosen, seen, select, stopAll };
  connect();
}
