// SPDX-License-Identifier: Apache-2.0
// The change that runs, step by step, and those before it.

import { at, byId, bytes, duration, empty, h, keyed, text } from "./dom.js";

// What the colours of the bars mean; style.css has the colours.
const KINDS = [["validate", "check"], ["quiesce", "stop streams"], ["overlay_remove", "overlays"], ["load", "load"],
  ["registers", "registers"], ["other", "all else"]];

export class Changes {
  constructor({ ask, control }) {
    this.control = control;
    const node = byId("progress");
    this.title = h("strong");
    this.step = h("span", { class: "muted" });
    this.bar = h("progress", { max: 1, "aria-label": "How far it is" });
    this.cancel = h("button", { type: "button", text: "Cancel", onclick: () => ask("cancel", {}, this.cancel) });
    byId("changes").before(h("ul", { class: "key" }, ...KINDS.map(([step, name]) => h("li", {}, h("i", { "data-step": step }), name))));
    node.append(h("div", { class: "row" }, this.title, this.step, h("span", { class: "stretch" }), this.cancel), this.bar);
  }

  show({ changes = [], status }) {
    const running = status?.progress;
    byId("progress").hidden = !running;
    if (running) {
      text(this.title, `to ${running.target_config} / ${running.target_mode}`);
      const size = running.bytes_total ? `, ${bytes(running.bytes_done)} of ${bytes(running.bytes_total)}` : "";
      text(this.step, `${running.step} ${running.subject}${size}`);
      this.bar.value = running.fraction;
      this.cancel.hidden = !this.control();
    }
    keyed(byId("changes"), [...changes].reverse(), (change) => `${change.at}/${change.number}`, () => make(), update);
    empty(byId("changes"), !changes.length, "None since this page's server began to look.");
  }
}

function make() {
  const parts = {
    where: h("strong"), when: h("span", { class: "muted" }), took: h("span", { class: "took" }),
    bar: h("div", { class: "steps", "aria-hidden": "true" }), list: h("ol", { class: "legend" }), why: h("p", { class: "muted small" }),
  };
  const details = h("details", {}, h("summary", {}, h("span", { class: "row" }, parts.where, parts.when,
    h("span", { class: "stretch" }), parts.took), parts.bar), parts.why, parts.list);
  return { node: h("li", {}, details), parts, shown: "" };
}

function update(row, change) {
  const stamp = JSON.stringify([change.state, change.steps, change.seconds]);
  if (row.shown === stamp) return; // those that have ended stay as they are
  row.shown = stamp;
  const { parts, node } = row;
  node.dataset.state = change.state;
  node.dataset.number = change.number;
  text(parts.where, `${change.config} / ${change.mode}`);
  text(parts.when, `#${change.number} · ${at(change.at)}`);
  text(parts.took, change.state === "running" ? "…" : `${change.state === "done" ? "" : `${change.error?.code ?? change.state}, `}${duration(change.seconds)}`);
  text(parts.why, change.error?.message);
  const steps = change.steps.map((step, index) => ({ ...step, index }));
  keyed(parts.bar, steps, (step) => step.index, (step) => ({ node: h("i", { "data-step": step.step }) }), ({ node: part }, step) => {
    part.style.flexGrow = Math.max((step.seconds ?? 0) * 1e6, 1);
    part.title = `${step.step} ${step.subject}: ${duration(step.seconds)}`;
  });
  keyed(parts.list, steps, (step) => step.index, (step) => {
    const took = h("span", { class: "muted" });
    const node = h("li", {}, h("i", { "data-step": step.step }), h("span", { text: `${step.step} ${step.subject}` }), took);
    return { node, took };
  }, (item, step) => text(item.took, duration(step.seconds)));
}
