// SPDX-License-Identifier: Apache-2.0
// Interrupts and leases.

import { at, byId, empty, h, keyed, text } from "./dom.js";

export class Notices {
  interrupts(found) {
    const node = byId("interrupts");
    keyed(node, Object.entries(found), ([name]) => name, ([name]) => {
      const count = h("output", { class: "value" });
      const when = h("span", { class: "muted small" });
      const dot = h("i", { class: "dot", "aria-hidden": "true" });
      return { node: h("div", { class: "row line", "data-interrupt": name }, dot, h("code", { text: name }), when, h("span", { class: "stretch" }), count), count, when, dot };
    }, (row, [, { count, at: when, doc }]) => {
      if (row.count.textContent && row.count.textContent !== String(count)) {
        row.dot.classList.toggle("beat");
        row.dot.dataset.came = "true";
      }
      text(row.count, count);
      text(row.when, when ? at(when) : "");
      if (doc) row.node.title = doc;
    });
    empty(node, !Object.keys(found).length, "The loaded configuration has none.");
  }

  leases(status) {
    const found = status.leases ?? [];
    const node = byId("leases");
    keyed(node, found, (lease) => lease.number, () => {
      const parts = { scope: h("code"), how: h("span", { class: "chip" }), holder: h("span", { class: "muted" }), left: h("output", { class: "value" }) };
      return { node: h("div", { class: "row line" }, parts.scope, parts.how, parts.holder, h("span", { class: "stretch" }), parts.left), parts };
    }, ({ parts }, lease) => {
      text(parts.scope, lease.scope);
      text(parts.how, lease.exclusive ? "alone" : "shared");
      text(parts.holder, [lease.holder, lease.client].filter(Boolean).join(", "));
      text(parts.left, `${Math.round(lease.seconds)} s left`);
    });
    empty(node, !found.length, "Nobody holds anything.");
  }
}
