// SPDX-License-Identifier: Apache-2.0
// Ten minutes of rates, latencies, changes and what the board measures: a small chart for each.

import { axes, span, ticks } from "./axes.js";
import { at, h, keyed, text } from "./dom.js";

const KEPT = 600; // seconds
const TITLES = { rate: ["Frame rate", "/s"], latency: ["Latency", "µs"], change: ["Changes of mode", "ms"],
  temperature: ["Temperature", "°C"], voltage: ["Voltage", "V"], current: ["Current", "A"], power: ["Power", "W"] };
// What is measured is shown over at least so much of its unit; all else from 0 on.
const LEAST = { temperature: 4, voltage: 0.1, current: 0.1, power: 0.5 };
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
    const parts = { canvas, legend: h("ul", { class: "series" }), when: h("span", { class: "muted small" }) };
    canvas.addEventListener("pointermove", (event) => this.point(row, event.offsetX));
    canvas.addEventListener("pointerleave", () => this.point(row, null));
    const [title, unit] = TITLES[group] ?? [group, ""];
    const row = { node: h("figure", { class: "chart", "data-chart": group }, h("figcaption", { class: "row" }, h("strong", { text: title }),
      h("span", { class: "muted small", text: unit }), h("span", { class: "stretch" }), parts.when), canvas, parts.legend), parts, group, hover: null };
    return row;
  }

  point(row, x) {
    row.hover = x;
    this.paint(row, row.group, row.names);
  }

  paint(row, group, names) {
    row.names = names;
    const all = this.points.flatMap((point) => names.map((name) => point.values[name]).filter((value) => value !== undefined));
    const [low, high] = scale(all, group);
    const end = this.points.at(-1)?.at ?? 0;
    const minutes = Math.min(KEPT / 60, Math.max(1, Math.ceil((end - (this.points[0]?.at ?? end)) / 60)));
    const plot = axes(row.parts.canvas, { low: -minutes, high: 0, label: ago, most: 3 }, { low, high });
    if (!plot) return;
    const x = (time) => plot.x((time - end) / 60);
    names.forEach((name, index) => {
      plot.context.strokeStyle = plot.context.fillStyle = colour(plot.style, index);
      plot.context.lineWidth = 1.5;
      if (group === "change") this.dots(plot.context, name, x, plot.y);
      else this.line(plot.context, name, x, plot.y);
    });
    this.tell(row, plot, x, { low, high, minutes });
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

  tell(row, { style, canvas, context, area }, x, { low, high, minutes }) {
    const shown = row.hover === null ? this.points.at(-1) : nearest(this.points, row.hover, x);
    text(row.parts.when, row.hover === null || !shown ? "" : at(shown.at));
    if (row.hover !== null && shown) {
      context.fillStyle = style.getPropertyValue("--muted");
      context.fillRect(Math.round(x(shown.at)), area.top, 1, area.height);
    }
    canvas.setAttribute("aria-label", `${row.group}, ${low.toPrecision(3)} to ${high.toPrecision(3)} over ${minutes} minutes`);
    keyed(row.parts.legend, row.names.map((name, index) => ({ name, index })), ({ name }) => name, ({ name }) => {
      const value = h("output");
      const mark = h("i", { "aria-hidden": "true" });
      return { node: h("li", {}, mark, h("span", { text: name.slice(name.indexOf(":") + 1).replace(/^change$/, "last") }), value), value, mark };
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
  const [low, high] = [Math.min(...all), Math.max(...all)];
  const room = (high - low) * 0.05;
  const [from, to] = group in LEAST ? span(low - room, high + room, LEAST[group]) : [0, high || 1];
  const { step } = ticks(from, to, 3);
  return [Math.floor(from / step) * step, Math.ceil(to / step) * step];
}

function ago(minutes) {
  if (!minutes) return "now";
  return minutes > -1 ? `−${Math.round(-minutes * 60)} s` : `−${Number((-minutes).toFixed(1))} min`;
}

function nearest(points, place, x) {
  return points.reduce((best, point) => (Math.abs(x(point.at) - place) < Math.abs(x(best.at) - place) ? point : best), points[0]);
}
