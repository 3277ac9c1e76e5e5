// SPDX-License-Identifier: Apache-2.0
// One register: what it holds, field by field, and the controls that write it.

import { h, hex, set, text } from "./dom.js";

const SLIDER_BITS = 12; // a wider one without bounds is a number to type
const BETWEEN = 60; // milliseconds between two writes while a slider moves
const SETTLED = 1000; // milliseconds from an answered write until what the board says counts, whatever it is

export class Register {
  // `again()`: show what the board says, where a write was refused.
  constructor(register, { ask, control, again }) {
    Object.assign(this, { register, ask, control, again });
    this.hex = h("code", { class: "hex" });
    this.when = h("span", { class: "when muted small" });
    const head = [h("code", { class: "name", text: register.name }), h("span", { class: "muted small", text: register.access }), this.when];
    const fields = register.fields.length ? register.fields : [null];
    this.node = h("div", { class: "register", "data-register": register.name, title: `${hex(register.address)} · ${register.width} bit` });
    this.values = fields.map((field) => this.makeValue(field));
    const whole = register.fields.length ? [] : [this.values[0].node];
    this.hex.hidden = this.values[0].input?.type === "text"; // which shows it
    this.node.append(h("div", { class: "head" }, ...head, ...whole, this.hex));
    if (register.doc) this.node.append(h("p", { class: "muted small", text: register.doc }));
    if (register.fields.length) this.node.append(h("div", { class: "fields" }, ...this.values.map((value) => value.node)));
  }

  makeValue(field) {
    const { register } = this;
    const name = field ? `${register.name}.${field.name}` : register.name;
    const row = { field, own: null };
    const send = throttled(async (value) => {
      const done = await this.ask("write", { name, value }, this.node);
      if (done === undefined) {
        row.own = null;
        this.again();
      } else if (row.own?.value === value) row.own.answered = performance.now();
    });
    const write = (value) => {
      row.own = { value, answered: Infinity };
      send(value);
    };
    row.input = this.input(field, name, write);
    row.shown = h("output", { class: "value" });
    row.clear = register.access === "w1c"
      ? h("button", { type: "button", class: "small", text: "clear", "aria-label": `clear ${name}`, onclick: () => write(field ? 2 ** field.width - 1 : 0xffffffff) })
      : null;
    const label = field ? h("span", { class: "field", text: field.name, title: field.doc }) : null;
    row.node = h("div", { class: "value-row" }, label, row.input, row.clear, row.shown);
    return row;
  }

  input(field, name, write) {
    const { register } = this;
    if (register.access === "ro" || register.access === "w1c") return null;
    const [low, high] = bounds(register, field);
    const label = { "aria-label": name };
    if (field?.values.length && field.values.length >= 2 ** field.width - 1) return choice(field, label, write);
    if (field && field.width === 1) {
      return h("input", { type: "checkbox", role: "switch", ...label, onchange: (event) => write(event.target.checked ? 1 : 0) });
    }
    if (high - low < 2 ** SLIDER_BITS) {
      return h("input", { type: "range", min: low, max: high, step: 1, ...label, onchange: () => this.again(),
        oninput: (event) => write(event.target.valueAsNumber) });
    }
    return h("input", { type: "text", inputmode: "text", spellcheck: "false", ...label, onchange: (event) => typed(event.target, write) });
  }

  update(held, when) {
    text(this.hex, held ? hex(held.value, this.register.width) : "—");
    text(this.when, when);
    for (const row of this.values) {
      const value = held && (row.field ? held.fields[row.field.name] : held.value);
      const name = row.field?.values.find(([, known]) => known === value)?.[0];
      text(row.shown, value === undefined || row.input?.tagName === "SELECT" || row.input?.type === "checkbox" ? "" : name ?? value);
      const off = !this.control();
      if (row.clear) row.clear.disabled = off;
      if (!row.input) continue;
      row.input.disabled = off;
      if (value === undefined || row.input.matches(":active") || !settled(row, value)) continue; // the user is moving it
      if (row.input.type === "checkbox") row.input.checked = value > 0;
      else if (row.input.type === "text") {
        if (document.activeElement !== row.input) row.input.value = hex(value, this.register.width);
      } else row.input.value = String(value);
      if (row.input.type === "range") set(row.input, "aria-valuetext", name ?? null);
    }
  }
}

// Values on their way are older than one's own: a slider that took them would lose steps of the keyboard.
function settled(row, value) {
  if (row.own && value !== row.own.value && performance.now() - row.own.answered < SETTLED) return false;
  row.own = null;
  return true;
}

function bounds(register, field) {
  const width = field ? field.width : register.width;
  return [(field ? null : register.minimum) ?? 0, (field ? null : register.maximum) ?? 2 ** width - 1];
}

function choice(field, label, write) {
  const options = field.values.map(([name, value]) => h("option", { value, text: name }));
  for (let value = 0; value < 2 ** field.width; value++) {
    if (!field.values.some(([, known]) => known === value)) options.push(h("option", { value, text: value }));
  }
  return h("select", { ...label, onchange: (event) => write(Number(event.target.value)) }, ...options);
}

function typed(input, write) {
  const value = Number(input.value.trim());
  const good = input.value.trim() !== "" && Number.isSafeInteger(value) && value >= 0;
  input.setCustomValidity(good ? "" : "a number is wanted: 18, or 0x12");
  input.reportValidity();
  if (good) write(value);
}

// The first at once, then the newest of what came meanwhile.
function throttled(call) {
  let waiting = null;
  let timer = 0;
  const next = () => {
    timer = 0;
    if (waiting !== null) {
      call(waiting);
      waiting = null;
      timer = setTimeout(next, BETWEEN);
    }
  };
  return (value) => {
    waiting = value;
    if (!timer) next();
  };
}
