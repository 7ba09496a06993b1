// Add tasks by clicks on the floor or by numbers, list and cancel them, and set goals by clicks.
import { numbers } from "./canvas.js";
import { ask, nameOf, on } from "./line.js";
import { make } from "./table.js";

const find = (id) => document.getElementById(id);
const set = (id, value) => (find(id).value = value);
let pickup = null; // (2,) m, clicked; its delivery place is not clicked yet
let shown = ""; // the tasks that are listed, as JSON

export const tasks = {
  add: () => {
    const both = find("task_kind").value === "two";
    const values = numbers("load", "pickup_x", "pickup_y", ...(both ? ["delivery_x", "delivery_y"] : []));
    if (!values) return;
    const [load, x, y, ...delivery] = values;
    ask({ ask: "add-task", pickup: [x, y], delivery: both ? delivery : null, load });
  },
};

function clicked([x, y]) {
  if (find("pick").checked) {
    set("goal_x", x);
    set("goal_y", y);
  }
  if (!find("placing").checked) return;
  if (!pickup) {
    pickup = [x, y];
    set("pickup_x", x);
    set("pickup_y", y);
    if (find("task_kind").value === "two") return said(`pickup at ${x}, ${y} m: now click the delivery place`);
  } else {
    set("delivery_x", x);
    set("delivery_y", y);
  }
  pickup = null;
  tasks.add();
}

function said(text) {
  if (find("tasks-said").textContent !== text) find("tasks-said").textContent = text;
}

function list(known) {
  if (!known) return said("Tasks cannot be added to this mission.");
  const text = JSON.stringify(known);
  if (text === shown) return;
  shown = text;
  const open = known.filter(({ fate }) => fate === "open" || fate === "aboard").length;
  if (!pickup) said(`${known.length} tasks, ${open} to do`);
  find("tasks").replaceChildren(...known.map((task) => {
    const ways = [task.pickup, task.delivery].filter(Boolean).map((spot) => spot.map((x) => x.toFixed(2)).join(", ")).join(" → ");
    const robot = task.robot == null ? "" : ` drone ${nameOf(task.robot)}`;
    const item = make("li", { "data-task": task.id }, `task ${task.id}: ${ways} m, load ${task.load}: ${task.fate}${robot} `);
    if (task.fate === "open") {
      const cancel = make("button", { "aria-label": `cancel task ${task.id}` }, "cancel");
      cancel.addEventListener("click", () => ask({ ask: "cancel-task", id: task.id }));
      item.append(cancel);
    }
    return item;
  }));
}

export function start() {
  on("floor", clicked);
  on("tasks", list);
}
