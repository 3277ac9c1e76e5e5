// SPDX-License-Identifier: Apache-2.0
// A frame that is a signal: over time, as a spectrum, or as points in the complex plane.

import { axes, span, ticks } from "./axes.js";

export const VIEWS = [["", "Over time"], ["spectrum", "Spectrum"], ["constellation", "Constellation"]];
const DEEP = 40; // dB that a spectrum shows at least
const held = new WeakMap(); // by canvas: its last scale, so that it does not jump with the noise of each frame

export function signal(canvas, header, payload) {
  const values = new Float32Array(payload.slice().buffer);
  if (header.view === "constellation") points(canvas, header, values);
  else if (header.view === "spectrum") spectrum(canvas, header, values);
  else time(canvas, header, values);
}

// The least and the greatest of each column, as an oscilloscope draws it.
function time(canvas, { lines, columns, length, range }, values) {
  const [low, high] = steady(canvas, "time", ...span(...range, least(range)));
  const plot = axes(canvas, { low: 0, high: length, name: "samples" }, { low, high });
  if (!plot) return;
  const place = (column) => plot.x(((column + 0.5) * length) / columns);
  lines.forEach((_, line) => {
    stroke(plot, line);
    const from = line * 2 * columns;
    for (let i = 0; i < columns; i++) {
      plot.context.lineTo(place(i), plot.y(values[from + i]));
      plot.context.lineTo(place(i), plot.y(values[from + columns + i]));
    }
    plot.context.stroke();
  });
}

function spectrum(canvas, { columns, low, high, range }, values) {
  const [bottom, top] = steady(canvas, "spectrum", Math.min(range[0], range[1] - DEEP), Math.max(0, range[1]));
  const plot = axes(canvas, { low, high, name: "× sample rate" }, { low: bottom, high: top, label: (value) => `${value} dB`.replace("-", "−") });
  if (!plot) return;
  stroke(plot, 0);
  for (let i = 0; i < columns; i++) plot.context.lineTo(plot.x(low + ((high - low) * i) / columns), plot.y(values[i]));
  plot.context.stroke();
}

// A square: one unit is as long along I as along Q.
function points(canvas, { columns, range }, values) {
  const most = Math.max(Math.abs(range[0]), Math.abs(range[1])) || 1;
  const [, edge] = steady(canvas, "constellation", -most, most);
  const wide = edge * Math.max(1, (canvas.clientWidth - 50) / Math.max(1, canvas.clientHeight - 25));
  const plot = axes(canvas, { low: -wide, high: wide, name: "I" }, { low: -edge, high: edge });
  if (!plot) return;
  stroke(plot, 0);
  for (let i = 0; i < columns; i++) plot.context.fillRect(plot.x(values[i]) - 1, plot.y(values[columns + i]) - 1, 2, 2);
  plot.context.fillStyle = plot.style.getPropertyValue("--muted");
  plot.context.textAlign = "left";
  plot.context.fillText("Q", plot.area.left + 4, plot.area.top + 10);
}

function stroke({ context, style, area }, line) {
  context.strokeStyle = context.fillStyle = style.getPropertyValue(`--series-${line}`);
  context.globalAlpha = 0.9;
  context.lineWidth = area.width > 500 ? 1.3 : 1;
  context.lineJoin = "round";
  context.beginPath();
}

const least = ([low, high]) => Math.max(Math.abs(low), Math.abs(high)) * 0.01 || 1;

// Ends at round numbers, and stays while what comes fits it and fills a third of it.
function steady(canvas, view, low, high) {
  const last = held.get(canvas);
  const fits = last?.view === view && low >= last.low && high <= last.high && high - low > (last.high - last.low) / 3;
  if (fits) return [last.low, last.high];
  const { step } = ticks(low, high, 4);
  const found = { view, low: Math.floor(low / step) * step, high: Math.ceil(high / step) * step };
  held.set(canvas, found);
  return [found.low, found.high];
}
