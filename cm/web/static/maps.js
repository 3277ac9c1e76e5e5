// SPDX-License-Identifier: Apache-2.0
// What was loaded into each region, frame by frame: drawn by the page's server, asked for when it is opened.

import { byId, h, keyed, set, text } from "./dom.js";

export class Maps {
  constructor({ ask, control }) {
    Object.assign(this, { ask, control, node: byId("maps") });
  }

  show({ status }) {
    if (!status) return;
    keyed(this.node, status.regions, (region) => region.name, (region) => this.made(region.name), (row, region) => {
      set(row.node, "data-module", region.module ?? "");
      row.compare.hidden = !this.control();
      text(row.health, found(region.health));
      const holds = `${region.state} ${region.module ?? ""} ${region.health?.wrong_bits ?? ""}`;
      if (row.holds !== holds && row.node.open) this.draw(row, false);
      row.holds = holds;
    });
  }

  made(name) {
    const picture = h("div", { class: "map", tabindex: 0, role: "group", "aria-label": `Frames of ${name}` });
    const compare = h("button", { type: "button", class: "quiet small", text: "Compare with what was loaded", hidden: true });
    const health = h("span", { class: "muted" });
    const node = h("details", { "data-map": name }, h("summary", { text: `Frames of ${name}` }, health), compare, picture);
    const row = { node, name, picture, compare, health, holds: "" };
    node.addEventListener("toggle", () => node.open && this.draw(row, false));
    compare.addEventListener("click", () => this.draw(row, true));
    return row;
  }

  async draw(row, check) {
    row.compare.disabled = true;
    const drawing = await this.ask("map", { region: row.name, check }, row.node);
    row.compare.disabled = false;
    if (drawing === undefined) row.picture.replaceChildren();
    else row.picture.replaceChildren(document.importNode(new DOMParser().parseFromString(drawing, "image/svg+xml").documentElement, true));
  }
}

function found(health) {
  if (!health?.checks) return "";
  const now = health.wrong_bits ? `, ${health.wrong_bits} bits are wrong` : health.checked_ns ? ", good by the last" : ", none since it was loaded";
  return `compared ${health.checks === 1 ? "once" : `${health.checks} times`}, ${health.upsets} upsets, ${health.repairs} repairs${now}`;
}
