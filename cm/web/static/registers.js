// SPDX-License-Identifier: Apache-2.0
// Registers of the loaded mode: by module, folded at will, found by a word, or those that changed last first.

import { at, empty, h, hex, keyed, text } from "./dom.js";
import { Register } from "./register.js";

const FEW = 8; // registers that need no filter

export class Registers {
  constructor(node, { ask, control }) {
    Object.assign(this, { node, ask, control, changed: new Map(), held: {}, inside: false });
    // Not :hover, which stays after a tap on a touch screen.
    node.addEventListener("pointermove", (event) => { this.inside = event.pointerType === "mouse"; });
    node.addEventListener("pointerleave", () => { this.inside = false; });
    this.filter = h("input", { type: "search", placeholder: "Filter", "aria-label": "Filter registers by a word", oninput: () => this.again() });
    this.order = h("select", { "aria-label": "Order of registers", onchange: () => this.again() },
      h("option", { value: "", text: "by module" }), h("option", { value: "changed", text: "last changed first" }));
    this.count = h("span", { class: "muted small", role: "status" });
    this.tools = h("div", { class: "tools" }, this.filter, this.order, this.count);
    node.before(this.tools);
  }

  again() {
    if (this.last) this.show(this.last);
  }

  show(state) {
    const { config, registers = {}, status } = state;
    if (!status) return;
    this.last = state;
    this.note(registers, status);
    const all = (config?.registers ?? []).filter((r) => !r.modes.length || r.modes.includes(config.mode));
    const shown = matching(all, this.filter.value);
    this.tools.hidden = all.length <= FEW;
    text(this.count, shown.length === all.length ? `${all.length} registers` : `${shown.length} of ${all.length}`);
    const groups = this.order.value ? this.recent(shown) : byModule(shown, status);
    keyed(this.node, groups, ([title]) => title, ([title]) => this.makeGroup(title), (group, [title, own]) => {
      text(group.count, own.length);
      if (this.filter.value) group.node.open = true;
      keyed(group.list, own, key, (register) => new Register(register, { ask: this.ask, control: this.control, again: () => this.again() }),
        (row, register) => row.update(registers[register.name], this.order.value && this.changed.has(register.name) ? at(this.changed.get(register.name)) : ""));
    });
    empty(this.node, !shown.length, all.length ? "No register has that word." : "The loaded mode has no registers.");
  }

  // When each was seen to change; a mode's first values are no change.
  note(registers, status) {
    const place = `${status.started_ns} ${status.config_name} ${status.mode}`;
    if (this.place !== place) this.held = {};
    this.place = place;
    for (const [name, { value }] of Object.entries(registers)) {
      if (name in this.held && this.held[name] !== value) this.changed.set(name, Date.now() / 1000);
      this.held[name] = value;
    }
  }

  // One list; it stays as it is while the user is in it, so that nothing moves under the hand.
  recent(shown) {
    const names = shown.map((register) => register.name).sort().join();
    if (this.recently?.names !== names || !(this.inside || this.node.matches(":focus-within"))) {
      const when = (register) => this.changed.get(register.name) ?? 0;
      this.recently = { names, own: shown.toSorted((a, b) => when(b) - when(a)) };
    }
    return [["last changed first", this.recently.own]];
  }

  makeGroup(title) {
    const list = h("div", { class: "registers" });
    const count = h("span", { class: "muted small" });
    const node = h("details", { class: "group", "data-group": title, open: true }, h("summary", {}, h("h3", { text: title }), count), list);
    return { node, list, count };
  }
}

const key = (register) => `${register.name}@${register.address}/${register.fields.length}`;

function matching(all, words) {
  const wanted = words.trim().toLowerCase().split(/\s+/);
  return all.filter((register) => {
    const known = [register.name, register.doc, register.region, hex(register.address), ...register.fields.flatMap((field) => [field.name, field.doc])];
    const said = known.join(" ").toLowerCase();
    return wanted.every((word) => said.includes(word));
  });
}

// Those of the static part, of each region whatever it holds, and of the module in it.
function byModule(shown, status) {
  const groups = new Map();
  for (const register of shown) {
    const module = status.regions.find((region) => region.name === register.region)?.module;
    const own = register.modes.length && module;
    const title = register.region ? `${register.region}${own ? ` · ${module}` : ""}` : "static part";
    groups.set(title, [...(groups.get(title) ?? []), register]);
  }
  const place = ([title]) => (title === "static part" ? "" : title);
  return [...groups].sort((a, b) => (place(a) < place(b) ? -1 : 1));
}
