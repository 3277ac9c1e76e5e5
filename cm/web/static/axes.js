// SPDX-License-Identifier: Apache-2.0
// A canvas with axes: as sharp as the screen, with round numbers, names and units at both.

const FOOT = 17; // pixels below the plot, for the numbers of x
const HEAD = 8; // above it, for the upper half of the greatest number of y

// About `most` round numbers from `low` to `high`: steps of 1, 2 or 5 times a power of ten.
export function ticks(low, high, most) {
  const raw = (high - low) / Math.max(1, most) || 1;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((factor) => factor * power >= raw * 0.999) * power;
  const first = Math.ceil(low / step - 1e-6);
  const count = Math.floor(high / step + 1e-6) - first;
  return { step, values: Array.from({ length: count + 1 }, (_, index) => (first + index) * step) };
}

// A number of an axis, no longer than its step needs.
export function short(value, step) {
  if (value === 0) return "0";
  for (const [unit, name] of [[1e9, "G"], [1e6, "M"], [1e3, "k"]]) {
    if (Math.abs(value) >= unit && step >= unit / 100) return `${trimmed(value / unit, step / unit)}${name}`;
  }
  return step < 1e-4 || Math.abs(value) >= 1e9 ? value.toExponential(1) : trimmed(value, step);
}

const trimmed = (value, step) => value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-6))).replace("-", "−");

// From `low` to `high`, never less than `least` apart: noise of the last digit is no news.
export function span(low, high, least) {
  const more = Math.max(0, least - (high - low)) / 2;
  return [low - more, high + more];
}

// `x` and `y`: {low, high, name, label(value), most}. Returns where to draw, and how: {context, x(value), y(value), …}.
export function axes(canvas, x, y) {
  const [width, height, ratio] = [canvas.clientWidth, canvas.clientHeight, devicePixelRatio || 1];
  if (!width || !height) return null;
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const context = canvas.getContext("2d");
  const style = getComputedStyle(canvas);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = `11px ${style.getPropertyValue("--sans")}`;
  const rows = ticks(y.low, y.high, y.most ?? Math.max(2, Math.floor((height - FOOT) / 30)));
  const label = y.label ?? ((value) => short(value, rows.step));
  const left = Math.ceil(Math.max(...rows.values.map((value) => context.measureText(label(value)).width), 12)) + 8;
  const area = { left, top: HEAD, width: width - left - 6, height: height - FOOT - HEAD };
  const plot = { context, area, style, canvas,
    x: (value) => area.left + ((value - x.low) / (x.high - x.low || 1)) * area.width,
    y: (value) => area.top + area.height - ((value - y.low) / (y.high - y.low || 1)) * area.height };
  grid(plot, x, rows.values, label);
  return plot;
}

function grid({ context, area, style, x: px, y: py }, x, rows, label) {
  context.strokeStyle = style.getPropertyValue("--line");
  context.fillStyle = style.getPropertyValue("--muted");
  context.lineWidth = 1;
  context.beginPath();
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const value of rows) {
    const y = Math.round(py(value)) + 0.5;
    context.moveTo(area.left, y);
    context.lineTo(area.left + area.width, y);
    context.fillText(label(value), area.left - 6, y);
  }
  context.textBaseline = "alphabetic";
  const foot = area.top + area.height;
  const columns = ticks(x.low, x.high, x.most ?? Math.max(2, Math.floor(area.width / 90)));
  const named = context.measureText(x.name ?? "").width; // stands at the end of the axis, in place of a number
  for (const value of columns.values) {
    const place = Math.round(px(value)) + 0.5;
    context.moveTo(place, area.top);
    context.lineTo(place, foot);
    const words = x.label ? x.label(value) : short(value, columns.step);
    const half = context.measureText(words).width / 2;
    const middle = Math.min(Math.max(place, area.left + half), area.left + area.width - half);
    if (!named || middle + half < area.left + area.width - named - 8) {
      context.textAlign = "center";
      context.fillText(words, middle, foot + 13);
    }
  }
  context.stroke();
  context.textAlign = "right";
  context.fillText(x.name ?? "", area.left + area.width, foot + 13);
}
