// SPDX-License-Identifier: Apache-2.0
// Elements, made once and changed in place: a page that is open for weeks must not grow.

const SVG = "http://www.w3.org/2000/svg";
const SHAPES = new Set(["svg", "g", "rect", "path", "text", "line", "circle", "polyline", "title", "defs", "pattern"]);

function fill(node, props, kids) {
  for (const [name, value] of Object.entries(props)) set(node, name, value);
  node.append(...kids.filter((kid) => kid !== null && kid !== undefined));
  return node;
}

export function set(node, name, value) {
  if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
  else if (name === "text") text(node, value);
  else if (value === null || value === undefined || value === false) node.removeAttribute(name);
  else if (node.getAttribute(name) !== String(value)) node.setAttribute(name, value === true ? "" : value);
}

export const h = (tag, props = {}, ...kids) => fill(document.createElement(tag), props, kids);
export const s = (tag, props = {}, ...kids) => fill(document.createElementNS(SVG, tag), props, kids);
export const byId = (id) => document.getElementById(id);

export function text(node, value) {
  const wanted = String(value ?? "");
  if (node.textContent !== wanted) node.textContent = wanted;
}

const rows = new WeakMap();

// One child of `parent` for each item, by key, in their order: made when it comes, updated, removed when it goes.
export function keyed(parent, items, key, make, update) {
  const known = rows.get(parent) ?? new Map();
  rows.set(parent, known);
  const left = new Set(known.keys());
  let place = parent.firstChild;
  for (const item of items) {
    const name = key(item);
    left.delete(name);
    let row = known.get(name);
    if (!row) known.set(name, (row = make(item)));
    update(row, item);
    if (row.node === place) place = place.nextSibling;
    else parent.insertBefore(row.node, place);
  }
  for (const name of left) {
    known.get(name).node.remove();
    known.delete(name);
  }
}

export function empty(parent, isEmpty, sentence) {
  let note = parent.parentNode.querySelector(":scope > .nothing");
  if (!note) parent.after((note = h("p", { class: "nothing muted" })));
  text(note, sentence);
  note.hidden = !isEmpty;
}

export const hex = (value, width = 32) => `0x${BigInt(value).toString(16).padStart(Math.ceil(width / 4), "0")}`;

export function bytes(count) {
  for (const unit of ["B", "KiB", "MiB"]) {
    if (count < 1024) return `${count < 10 && unit !== "B" ? count.toFixed(1) : Math.round(count)} ${unit}`;
    count /= 1024;
  }
  return `${count.toFixed(1)} GiB`;
}

export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "…";
  if (seconds < 0.001) return `${Math.round(seconds * 1e6)} µs`;
  if (seconds < 1) return `${(seconds * 1e3).toPrecision(3).replace(/\.?0+$/, (z) => (z.includes(".") ? "" : z))} ms`;
  return `${seconds.toFixed(2)} s`;
}

const clock = new Intl.DateTimeFormat([], { hour: "2-digit", minute: "2-digit", second: "2-digit", hour12: false });
export const at = (seconds) => clock.format(new Date(seconds * 1000));
