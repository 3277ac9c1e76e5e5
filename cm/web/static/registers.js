// SPDX-License-Identifier: Apache-2.0
// Registers of the loaded mode by region, with their fields; sliders where their bounds are known.

import { empty, h, hex, keyed, set, tell, text } from "./dom.js";

const SLIDER_BITS = 12; // a wider one without bounds is a number to type
const BETWEEN = 60; // milliseconds between two writes while a slider moves
const SETTLED = 1000; // milliseconds from an answered write until what the board says counts, whatever it is

export class Registers {
  constructor(node, { ask, failed, control }) {
    Object.assign(this, { node, ask, failed, control });
  }

  show(state) {
    const { config, registers = {}, status } = state;
    if (!status) return;
    this.again = () => this.show(state); // where a write was refused, its control goes back to what the register holds
    const visible = (config?.registers ?? []).filter((r) => !r.modes.length || r.modes.includes(config.mode));
    const groups = new Map();
    for (const register of visible) {
      const place = register.region || "static part";
      groups.set(place, [...(groups.get(place) ?? []), register]);
    }
    keyed(this.node, [...groups], ([place]) => place, ([place]) => {
      const list = h("div", { class: "registers" });
      return { node: h("div", {}, h("h3", { text: place }), list), list };
    }, (row, [, all]) => {
      keyed(row.list, all, key, (register) => this.make(register), (item, register) => {
        this.update(item, register, registers[register.name]);
      });
    });
    empty(this.node, !visible.length, "The loaded mode has no registers.");
  }

  make(register) {
    const fields = register.fields.length ? register.fields : [null];
    const note = h("p", { class: "note", role: "alert", hidden: true });
    const rows = fields.map((field) => this.makeValue(register, field, note));
    const title = h("div", { class: "row" }, h("code", { text: register.name }), h("span", { class: "muted small", text: register.access }),
      h("span", { class: "stretch" }), h("code", { class: "hex" }));
    const node = h("div", { class: "register", "data-register": register.name, title: `${hex(register.address)} · ${register.width} bit` },
      title, register.doc ? h("p", { class: "muted small", text: register.doc }) : null, ...rows.map((row) => row.node), note);
    return { node, rows, hex: title.lastChild };
  }

  makeValue(register, field, note) {
    const name = field ? `${register.name}.${field.name}` : register.name;
    const row = { field, own: null };
    const send = throttled((value) => this.ask("write", { name, value }).then(
      () => { note.hidden = true; if (row.own?.value === value) row.own.answered = performance.now(); },
      (error) => { row.own = null; tell(note, error); this.again(); },
    ));
    const write = (value) => {
      row.own = { value, answered: Infinity };
      send(value);
    };
    const input = this.input(register, field, name, write);
    const shown = h("output", { class: "value" });
    const label = field ? h("span", { class: "field", text: field.name, title: field.doc }) : null;
    const clear = register.access === "w1c"
      ? h("button", { type: "button", class: "small", text: "clear", onclick: () => write(field ? 2 ** field.width - 1 : 0xffffffff) })
      : null;
    return Object.assign(row, { node: h("div", { class: "row value-row" }, label, input, clear, shown), input, clear, shown });
  }

  input(register, field, name, write) {
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

  update(item, register, held) {
    text(item.hex, held ? hex(held.value, register.width) : "—");
    for (const row of item.rows) {
      const value = held && (row.field ? held.fields[row.field.name] : held.value);
      const name = row.field?.values.find(([, known]) => known === value)?.[0];
      text(row.shown, value === undefined ? "" : name ?? value);
      const off = !this.control();
      if (row.clear) row.clear.disabled = off;
      if (!row.input) continue;
      row.input.disabled = off;
      if (value === undefined || row.input.matches(":active") || !settled(row, value)) continue; // the user is moving it
      if (row.input.type === "checkbox") row.input.checked = value > 0;
      else if (row.input.type === "text") {
        if (document.activeElement !== row.input) row.input.value = hex(value, register.width);
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

const key = (register) => `${register.name}@${register.address}/${register.fields.length}`;

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
