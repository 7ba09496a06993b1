// Show the log and the consoles of the drones' firmware, each with a filter; the newest line is the first.
import { nameOf, on, seen } from "./line.js";
import { make } from "./table.js";

const FIRMWARE_PREFIX = "firmware: "; // of a line of a console, as the drones tell it
const MAX_LINES = 500; // of a list
const LOG_LEVELS = ["info", "warning", "error"]; // in increasing severity
const find = (id) => document.getElementById(id);

// Return the time of day in this browser for a time of the server's clock.
// t: s
// latest: s, time of the newest line, used before the first frame
function moment(t, latest) {
  return new Date(Date.now() - 1000 * ((seen.at || latest) - t)).toLocaleTimeString("en-GB");
}

const origin = ({ drone }) => (drone == null ? "" : `drone ${nameOf(drone)}: `);

// Show the lines that the server sends of this kind.
// filter: the field with the filter
// text: returns the text of a line
// passes: returns whether the filter lets a line pass, from its value and the data of the line
function list(kind, filter, text, passes) {
  const items = find(kind);
  on(kind, (lines) => {
    for (const line of lines) {
      const data = { "data-level": line.level, "data-drone": line.drone ?? "" };
      const item = make("li", data, `${moment(line.t, lines.at(-1).t)} ${text(line)}`);
      item.hidden = !passes(filter.value, item.dataset);
      items.prepend(item);
    }
    while (items.children.length > MAX_LINES) items.lastChild.remove();
  });
  on("about", () => items.replaceChildren());
  filter.addEventListener("change", () => {
    for (const item of items.children) item.hidden = !passes(filter.value, item.dataset);
  });
}

export function start() {
  list("log", find("level"), (line) => `${line.level} ${origin(line)}${line.text}`,
    (level, data) => LOG_LEVELS.indexOf(data.level) >= LOG_LEVELS.indexOf(level));
  list("console", find("console-drone"), (line) => `${origin(line)}${line.text.replace(FIRMWARE_PREFIX, "")}`,
    (drone, data) => !drone || data.drone === drone);
}
