// SPDX-License-Identifier: Apache-2.0
// The one place where errors are told: below the header, wherever the page is scrolled to.

import { at, byId, h, keyed, text } from "./dom.js";

const KEPT = 50;
const NEWS = 60; // seconds for which one that was there before the page is told unasked
const SAME = 15; // seconds within which the same words are the same error: refused here, and in the board's status

export class Errors {
  constructor() {
    this.all = []; // newest first
    this.reported = 0; // of the board's, so many were taken
    this.list = h("ol", { class: "told" });
    this.older = h("button", { type: "button", class: "quiet small", "aria-expanded": "false", onclick: () => this.unfold(!this.isOpen) });
    this.node = byId("errors");
    this.node.append(this.list, h("span", { class: "row" }, this.older,
      h("button", { type: "button", class: "quiet small", text: "Close", onclick: () => this.close() })));
    byId("told").addEventListener("click", () => (this.node.hidden ? this.unfold(true) : this.close()));
    this.close();
  }

  // What was asked for here and refused, by the control `node`.
  refused(error, node) {
    this.add({ at: Date.now() / 1000, code: error.code, message: error.message });
    node?.setAttribute("data-refused", "true");
    node?.setAttribute("aria-describedby", "errors");
    this.open();
  }

  // The control was obeyed: what it was refused before is no news any more.
  done(node) {
    if (!node?.hasAttribute("data-refused")) return;
    unmark(node);
    if (!this.isOpen) this.close();
  }

  // A change has ended well, at `time`.
  settled(time) {
    if (!(this.all[0]?.at < time)) return;
    document.querySelectorAll(".go[data-refused]").forEach(unmark);
    if (!this.isOpen) this.close();
  }

  // What the board has reported, oldest first.
  board(found) {
    const begins = !this.reported;
    const fresh = found.filter((error) => error.at > this.reported);
    this.reported = found.at(-1)?.at ?? this.reported;
    for (const error of fresh) this.add(error);
    if (fresh.length && (!begins || Date.now() / 1000 - this.reported < NEWS)) this.open();
    this.show();
  }

  add(error) {
    const known = this.all.find((other) => other.code === error.code && other.message === error.message && Math.abs(other.at - error.at) < SAME);
    if (known) return;
    this.all = [error, ...this.all].sort((a, b) => b.at - a.at).slice(0, KEPT);
  }

  open() {
    this.node.hidden = false;
    this.show();
  }

  close() {
    this.node.hidden = true;
    this.unfold(false);
  }

  unfold(isOpen) {
    this.isOpen = isOpen;
    if (isOpen) this.node.hidden = false;
    this.show();
  }

  show() {
    const earlier = this.all.length - 1;
    byId("told").hidden = !this.all.length;
    text(byId("told"), `⚠ ${this.all.length}`);
    byId("told").setAttribute("aria-label", `Errors: ${this.all.length}`);
    this.older.hidden = earlier < 1;
    text(this.older, this.isOpen ? "Only the newest" : `${earlier} earlier`);
    this.older.setAttribute("aria-expanded", String(this.isOpen));
    keyed(this.list, this.isOpen ? this.all : this.all.slice(0, 1), (error) => `${error.at}${error.code}${error.message}`, (error) => ({
      node: h("li", {}, h("span", { class: "when", text: at(error.at) }), " ", error.code ? h("code", { text: error.code }) : null, " ", h("span", { text: error.message })),
    }), () => {});
  }
}

function unmark(node) {
  for (const name of ["data-refused", "aria-describedby"]) node.removeAttribute(name);
}
