// Draw curves on a canvas, and read numbers from fields.
import { colour, tell } from "./line.js";

const field = (id) => document.getElementById(id);

// Return the number in a field; NaN if the field is empty or holds no number.
export const number = (id) => (field(id).value.trim() ? Number(field(id).value) : NaN);

// Return the numbers in these fields. If a field holds no number, mark it, report it and return null: the caller then
// sends nothing.
export function numbers(...ids) {
  const values = ids.map(number);
  const none = ids.filter((id, k) => !Number.isFinite(values[k]));
  for (const id of ids) field(id).setAttribute("aria-invalid", none.includes(id));
  if (!none.length) return values;
  tell("refused", `${none.map((id) => field(id).labels[0].textContent).join(", ")}: no number; nothing was sent`);
  return null;
}

// Clear a canvas, set it to the screen's resolution, and return its 2D context; null while the canvas is hidden.
export function prepared(canvas) {
  const { clientWidth: w, clientHeight: h } = canvas;
  const ratio = window.devicePixelRatio || 1;
  if (!w || !h) return null;
  if (canvas.width !== Math.round(w * ratio)) canvas.width = Math.round(w * ratio);
  if (canvas.height !== Math.round(h * ratio)) canvas.height = Math.round(h * ratio);
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, w, h);
  pen.font = "11px system-ui";
  return pen;
}

// Return the number of decimals that resolves a range of values.
const digits = (span) => Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(span))));

// Draw curves with a common scale.
// list: curves, each {name, values, tint, dashed}; a tint is a colour, or the name of a colour of page.css
// foot: text below the curves, such as the range of x
// x: increasing positions of the values; the default is equal steps
// gap: two values that are farther apart in x are not joined
export function curves(canvas, list, foot, x = list[0]?.values.map((_, k) => k), gap = Infinity) {
  const pen = prepared(canvas);
  if (!pen) return;
  const { clientWidth: w, clientHeight: h } = canvas;
  const left = 50;
  const top = 16;
  const bottom = 16;
  const known = list.flatMap(({ values }) => values.filter(Number.isFinite));
  if (!known.length) {
    pen.fillStyle = colour("--faint");
    pen.fillText("no values", left, h / 2);
    return;
  }
  const least = Math.min(...known);
  const most = Math.max(...known);
  const low = least > 0.5 * most ? least : Math.min(0, least);
  const high = Math.max(most, low + 1e-3);
  const first = x[0];
  const last = Math.max(x.at(-1), first + 1e-3);
  const y = (value) => top + (h - top - bottom) * (1 - (value - low) / (high - low));
  pen.strokeStyle = colour("--rule");
  pen.fillStyle = colour("--faint");
  pen.lineWidth = 1;
  for (const value of [low, (low + high) / 2, high]) {
    pen.beginPath();
    pen.moveTo(left, y(value));
    pen.lineTo(w, y(value));
    pen.stroke();
    pen.fillText(value.toFixed(digits(high - low)), 2, y(value) + 4);
  }
  pen.textAlign = "right";
  pen.fillText(foot, w - 4, h - 3);
  pen.textAlign = "left";
  let named = left;
  for (const { name, values, tint, dashed } of list) {
    pen.strokeStyle = tint.startsWith("--") ? colour(tint) : tint;
    pen.fillStyle = pen.strokeStyle;
    pen.setLineDash(dashed ? [4, 3] : []);
    pen.lineWidth = 1.5;
    pen.beginPath();
    let drawn = false;
    values.forEach((value, k) => {
      if (!Number.isFinite(value)) {
        drawn = false;
        return;
      }
      if (k && x[k] - x[k - 1] > gap) drawn = false;
      const at = left + ((w - left) * (x[k] - first)) / (last - first);
      if (drawn) pen.lineTo(at, y(value));
      else pen.moveTo(at, y(value));
      drawn = true;
    });
    pen.stroke();
    pen.setLineDash([]);
    pen.fillText(name, named, 11);
    named += pen.measureText(name).width + 12;
  }
}
