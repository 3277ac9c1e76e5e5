// SPDX-License-Identifier: Apache-2.0
// Ten minutes of rates, latencies, changes and what the board measures: a small chart for each.

import { at, h, keyed, text } from "./dom.js";

const KEPT = 600; // seconds
const TITLES = { rate: ["Frame rate", "/s"], latency: ["Latency", "µs"], change: ["Changes of mode", "ms"],
  temperature: ["Temperature", "°C"], voltage: ["Voltage", "V"], current: ["Current", "A"], power: ["Power", "W"] };
const ORDER = Object.keys(TITLES);

export class Charts {
  constructor(node) {
    this.node = node;
    this.points = [];
    this.rows = [];
    new ResizeObserver(() => this.draw()).observe(node);
  }

  begin(points) {
    this.points = points.slice(-KEPT);
    this.draw();
  }

  add(point) {
    if (this.points.at(-1)?.at >= point.at) return;
    this.points.push(point);
    this.points.splice(0, this.points.length - KEPT);
    this.draw();
  }

  draw() {
    if (document.hidden && this.rows.length) return;
    const groups = new Map();
    for (const name of new Set(this.points.flatMap((point) => Object.keys(point.values)))) {
      const group = name.split(":")[0];
      groups.set(group, [...(groups.get(group) ?? []), name]);
    }
    const sorted = [...groups].sort(([a], [b]) => ORDER.indexOf(a) - ORDER.indexOf(b));
    this.rows = [];
    keyed(this.node, sorted, ([group]) => group, ([group]) => this.make(group), (row, [group, names]) => {
      this.rows.push(row);
      this.paint(row, group, names.sort());
    });
  }

  make(group) {
    const canvas = h("canvas", { role: "img" });
    const parts = { canvas, legend: h("ul", { class: "series" }), range: h("span", { class: "muted small" }) };
    canvas.addEventListener("pointermove", (event) => this.point(row, event.offsetX));
    canvas.addEventListener("pointerleave", () => this.point(row, null));
    const [title, unit] = TITLES[group] ?? [group, ""];
    const row = { node: h("figure", { class: "chart", "data-chart": group }, h("figcaption", { class: "row" }, h("strong", { text: title }),
      h("span", { class: "muted small", text: unit }), h("span", { class: "stretch" }), parts.range), canvas, parts.legend), parts, group, hover: null };
    return row;
  }

  point(row, x) {
    row.hover = x;
    this.paint(row, row.group, row.names);
  }

  paint(row, group, names) {
    const { canvas, legend, range } = row.parts;
    row.names = names;
    const [width, height, ratio] = [canvas.clientWidth, canvas.clientHeight, devicePixelRatio || 1];
    if (!width) return;
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const style = getComputedStyle(this.node);
    const all = this.points.flatMap((point) => names.map((name) => point.values[name]).filter((value) => value !== undefined));
    const [low, high] = scale(all, group);
    const end = this.points.at(-1)?.at ?? 0;
    const span = Math.min(KEPT, Math.max(60, Math.ceil((end - (this.points[0]?.at ?? end)) / 60) * 60));
    const x = (time) => width - ((end - time) / span) * width;
    const y = (value) => height - 3 - ((value - low) / (high - low || 1)) * (height - 6);
    context.strokeStyle = style.getPropertyValue("--line");
    for (let part = 1; part < 5; part++) {
      const place = Math.round((width * part) / 5) + 0.5;
      context.beginPath();
      context.moveTo(place, 0);
      context.lineTo(place, height);
      context.stroke();
    }
    names.forEach((name, index) => {
      context.strokeStyle = context.fillStyle = colour(style, index);
      context.lineWidth = 1.5;
      if (group === "change") this.dots(context, name, x, y);
      else this.line(context, name, x, y);
    });
    this.tell(row, names, style, x, row.hover, { legend, range, canvas, low, high, span });
  }

  line(context, name, x, y) {
    context.beginPath();
    let before = null;
    for (const { at: time, values } of this.points) {
      const value = values[name];
      if (value === undefined) before = null;
      else {
        if (before === null || time - before > 5) context.moveTo(x(time), y(value));
        else context.lineTo(x(time), y(value));
        before = time;
      }
    }
    context.stroke();
  }

  dots(context, name, x, y) {
    for (const { at: time, values } of this.points) {
      if (values[name] === undefined) continue;
      context.beginPath();
      context.arc(x(time) - 2, y(values[name]), 2.5, 0, 2 * Math.PI);
      context.fill();
    }
  }

  tell(row, names, style, x, hover, { legend, range, canvas, low, high, span }) {
    const shown = hover === null ? this.points.at(-1) : nearest(this.points, hover, x);
    text(range, hover === null || !shown ? `${span / 60} min` : at(shown.at));
    canvas.setAttribute("aria-label", `${row.group}, ${low.toPrecision(3)} to ${high.toPrecision(3)} over ${span / 60} minutes`);
    keyed(legend, names.map((name, index) => ({ name, index })), ({ name }) => name, ({ name }) => {
      const value = h("output");
      const mark = h("i", { "aria-hidden": "true" });
      return { node: h("li", {}, mark, h("span", { text: name.split(":")[1] ?? "last" }), value), value, mark };
    }, (item, { name, index }) => {
      item.mark.style.background = colour(style, index);
      const last = shown?.values[name] ?? (row.group === "change" ? this.points.findLast((p) => name in p.values)?.values[name] : undefined);
      text(item.value, last === undefined ? "–" : Number(last.toPrecision(4)));
    });
  }
}

const colour = (style, index) => style.getPropertyValue(`--series-${index % 5}`);

function scale(all, group) {
  if (!all.length) return [0, 1];
  const [least, most] = [Math.min(...all), Math.max(...all)];
  if (["rate", "latency", "change"].includes(group)) return [0, most * 1.1 || 1];
  const room = Math.max((most - least) * 0.15, Math.abs(most) * 0.005);
  return [least - room, most + room];
}

function nearest(points, place, x) {
  return points.reduce((best, point) => (Math.abs(x(point.at) - place) < Math.abs(x(best.at) - place) ? point : best), points[0]);
}
