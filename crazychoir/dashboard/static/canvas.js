// Curves on a canvas, and numbers of fields.
import { colour, tell } from "./line.js";

const field = (id) => document.getElementById(id);

// NaN of a field that is empty, or that the browser cannot read.
export const number = (id) => (field(id).value.trim() ? Number(field(id).value) : NaN);

// Of these fields; null if one has none: it is marked, and nothing should be sent.
export function numbers(...ids) {
  const values = ids.map(number), none = ids.filter((id, k) => !Number.isFinite(values[k]));
  for (const id of ids) field(id).setAttribute("aria-invalid", none.includes(id));
  if (!none.length) return values;
  tell("refused", `${none.map((id) => field(id).labels[0].textContent).join(", ")}: no number; nothing was sent`);
  return null;
}

// A clean canvas in the resolution of the screen; null while it is not seen.
export function prepared(canvas) {
  const { clientWidth: w, clientHeight: h } = canvas, ratio = window.devicePixelRatio || 1;
  if (!w || !h) return null;
  if (canvas.width !== Math.round(w * ratio)) canvas.width = Math.round(w * ratio);
  if (canvas.height !== Math.round(h * ratio)) canvas.height = Math.round(h * ratio);
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, w, h);
  pen.font = "11px system-ui";
  return pen;
}

const digits = (span) => Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(span))));

// Curves, {name, values, tint, dashed}; foot: from where to where; x: increasing, where their values are, else in equal
// steps; gap: a longer step is left open.
export function curves(canvas, list, foot, x = list[0]?.values.map((_, k) => k), gap = Infinity) {
  const pen = prepared(canvas);
  if (!pen) return;
  const { clientWidth: w, clientHeight: h } = canvas, left = 50, top = 16, bottom = 16;
  const known = list.flatMap(({ values }) => values.filter(Number.isFinite));
  if (!known.length) return;
  const least = Math.min(...known), most = Math.max(...known);
  const low = least > 0.5 * most ? least : Math.min(0, least), high = Math.max(most, low + 1e-3);
  const first = x[0], last = Math.max(x.at(-1), first + 1e-3);
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
    pen.strokeStyle = pen.fillStyle = colour(tint);
    pen.setLineDash(dashed ? [4, 3] : []);
    pen.lineWidth = 1.5;
    pen.beginPath();
    let drawn = false;
    values.forEach((value, k) => {
      if (!Number.isFinite(value)) return (drawn = false);
      if (k && x[k] - x[k - 1] > gap) drawn = false;
      const at = left + ((w - left) * (x[k] - first)) / (last - first);
      drawn ? pen.lineTo(at, y(value)) : pen.moveTo(at, y(value));
      drawn = true;
    });
    pen.stroke();
    pen.setLineDash([]);
    pen.fillText(name, named, 11);
    named += pen.measureText(name).width + 12;
  }
}
