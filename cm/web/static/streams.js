// SPDX-License-Identifier: Apache-2.0
// Streams, and their newest frames.

import { bytes, empty, h, keyed, set, text } from "./dom.js";
import { draw } from "./picture.js";
import { VIEWS } from "./signal.js";

export class Streams {
  constructor(node, link) {
    this.node = node;
    this.link = link;
    this.cards = new Map();
    this.wanted = new Set(); // chosen here
    this.refused = new Set(); // stopped here, though they run
    this.views = {}; // of signals, by stream
    this.pending = new Map();
    this.watching = "";
  }

  show({ status, watched = {}, link }) {
    if (!status) return;
    this.pid = link.pid;
    keyed(this.node, status.streams, (stream) => stream.name, (stream) => this.make(stream), (card, stream) => {
      this.update(card, stream, watched[stream.name] ?? "");
    });
    empty(this.node, !status.streams.length, "The loaded mode has no streams.");
    const names = new Set(status.streams.map((stream) => stream.name));
    for (const name of this.cards.keys()) if (!names.has(name)) this.cards.delete(name);
    this.watch(status.streams);
  }

  // Those that run anyway are looked at unless they were stopped here; others when they are asked for.
  watch(streams) {
    const names = streams.filter((stream) => this.isWatched(stream)).map((stream) => stream.name);
    const wanted = Object.fromEntries(names.map((name) => [name, this.views[name] ?? ""]));
    if (JSON.stringify(wanted) !== this.watching) {
      this.watching = JSON.stringify(wanted);
      this.link.watch(wanted);
    }
  }

  isWatched(stream) {
    if (stream.direction !== "s2mm" || stream.backpressure || this.refused.has(stream.name)) return false;
    return this.wanted.has(stream.name) || stream.open;
  }

  make(stream) {
    const name = stream.name;
    const canvas = h("canvas", { role: "img", "aria-label": `Frames of ${name}`, width: 16, height: 9 });
    const button = h("button", { type: "button", onclick: () => this.toggle(name) });
    const view = h("select", { class: "small", hidden: true, "aria-label": `How ${name} is drawn`, onchange: () => this.look(name, view.value) },
      ...VIEWS.map(([value, words]) => h("option", { value, text: words })));
    const parts = {
      kind: h("span", { class: "muted" }), button, canvas, choice: view, lines: h("ul", { class: "series" }),
      flow: h("dl", { class: "flow" }),
      note: h("p", { class: "note", role: "status" }),
      view: h("div", { class: "view" }, canvas, h("span", { class: "idle muted" })),
      readout: h("span", { class: "readout" }),
    };
    parts.view.append(parts.readout);
    const title = h("h3", {}, h("span", { class: "arrow", "aria-hidden": "true" }), h("span", { text: name }), " ", parts.kind);
    const node = h("article", { class: "card stream", "data-stream": name },
      h("div", { class: "row" }, title, h("span", { class: "stretch" }), view, button), parts.view, parts.lines, parts.note, parts.flow);
    const card = { node, parts, stream, drawn: 0, times: [] };
    this.cards.set(name, card);
    return card;
  }

  update(card, stream, problem) {
    card.stream = stream;
    const { parts, node } = card;
    const reads = stream.direction === "s2mm";
    node.dataset.direction = stream.direction;
    node.dataset.open = stream.open;
    text(node.querySelector(".arrow"), reads ? "↓" : "↑");
    node.querySelector(".arrow").title = reads ? "from the logic to the processor" : "from the processor to the logic";
    text(parts.kind, `${stream.shape.join(" × ") || "any length"} ${stream.dtype}`);
    const watched = this.isWatched(stream);
    parts.view.hidden = !reads;
    parts.button.hidden = !reads || stream.backpressure;
    text(parts.button, watched ? "Stop" : "Watch");
    set(parts.button, "aria-pressed", String(watched));
    set(parts.button, "aria-label", `${watched ? "Stop watching" : "Watch"} ${stream.name}`);
    parts.button.title = watched || stream.open ? "" : "The stream does not run now: watching starts it.";
    node.dataset.watched = watched;
    const idle = stream.backpressure ? "The hardware waits for each of its readers: it is not shown here."
      : watched ? "no frame yet" : stream.open ? "not shown" : "does not run";
    text(parts.view.querySelector(".idle"), idle);
    if (!watched) node.dataset.live = "false";
    parts.choice.hidden = parts.lines.hidden = node.dataset.live !== "true" || node.dataset.kind !== "signal";
    text(parts.note, problem || stream.last_error?.message || "");
    parts.note.hidden = !parts.note.textContent;
    this.flow(parts.flow, stream);
  }

  flow(node, stream) {
    const facts = stream.open
      ? [["rate", `${stream.rate.toFixed(1)}/s`], ["latency", `${Math.round(stream.latency_us)} µs`],
        ["frames", stream.frames], ["lost", stream.dropped], ["errors", stream.errors],
        ["readers", stream.clients.map((client) => (client.pid === this.pid ? "this page" : client.name || client.pid)).join(", ") || "none"]]
      : [["", "closed"], ["slots", stream.slots], ["buffer", bytes(stream.max_length || 0)]].slice(0, 2);
    keyed(node, facts, ([name]) => name, ([name]) => {
      const value = h("dd");
      return { node: h("div", {}, h("dt", { text: name }), value), value };
    }, (row, [name, value]) => {
      text(row.value, value);
      row.node.dataset.bad = (name === "lost" || name === "errors") && value > 0;
    });
  }

  toggle(name) {
    const { stream } = this.cards.get(name);
    if (this.isWatched(stream)) {
      this.wanted.delete(name);
      this.refused.add(name);
    } else {
      this.refused.delete(name);
      this.wanted.add(name);
    }
    for (const card of this.cards.values()) this.update(card, card.stream, "");
    this.watchAll();
  }

  look(name, view) {
    this.views[name] = view;
    this.watchAll();
  }

  watchAll() {
    this.watch([...this.cards.values()].map((card) => card.stream));
  }

  // Drawn with the next repaint, so never in a hidden page, which then gets no more.
  picture(header, payload) {
    if (!this.pending.size) requestAnimationFrame(() => this.drawAll());
    this.pending.set(header.stream, [header, payload]);
  }

  async drawAll() {
    const pictures = [...this.pending.values()];
    this.pending.clear();
    for (const [header, payload] of pictures) {
      const card = this.cards.get(header.stream);
      try {
        if (card) await this.drawOne(card, header, payload);
      } finally {
        this.link.drawn(header.stream);
      }
    }
  }

  async drawOne(card, header, payload) {
    card.node.dataset.kind = header.kind; // first: a signal's canvas takes its size from the page
    card.node.dataset.live = "true";
    await draw(card.parts.canvas, header, payload);
    const now = performance.now();
    card.times = [...card.times.filter((time) => time > now - 1000), now];
    card.drawn += 1;
    card.node.dataset.frames = card.drawn;
    card.node.dataset.mode = header.mode;
    if (header.kind === "signal") this.describe(card.parts, header);
    const range = header.range ? ` · ${header.range.map((value) => value.toPrecision(4)).join(" … ")}` : "";
    const unit = header.view === "spectrum" ? " dB of full scale" : "";
    const part = header.step ? ` · every ${header.step}. pixel` : "";
    text(card.parts.readout, `#${header.sequence} · ${card.times.length}/s drawn${range}${unit}${part}`);
  }

  describe({ choice, lines }, header) {
    choice.hidden = lines.hidden = false;
    choice.options[2].hidden = !header.complex; // points need two numbers
    const named = header.lines?.length > 1 ? header.lines.map((name, index) => ({ name, index })) : [];
    keyed(lines, named, ({ name }) => name, ({ name, index }) => ({ node: h("li", {}, h("i", { "data-series": index, "aria-hidden": "true" }), name) }), () => {});
  }
}
