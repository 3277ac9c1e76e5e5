// SPDX-License-Identifier: Apache-2.0
// A record's slider: what the page shows is as it was then.

import { byId, text } from "./dom.js";

export class RecordTime {
  constructor(ask) {
    this.slider = byId("when");
    this.slider.addEventListener("input", () => this.go(ask));
  }

  // One question at a time; where the slider stands when it is answered is the next.
  async go(ask) {
    this.say(Number(this.slider.value));
    if (this.busy) return void (this.again = true);
    this.busy = true;
    do {
      this.again = false;
      await ask("at", { ms: Number(this.slider.value) }, this.slider);
    } while (this.again);
    this.busy = false;
  }

  show(record) {
    byId("record").hidden = !record;
    if (!record) return;
    const { since_ms: min, until_ms: until } = record, step = Number(this.slider.step);
    Object.assign(this.slider, { min, max: min + Math.ceil((until - min) / step) * step }); // the end is a step too
    if (!this.busy) this.slider.value = record.at_ms;
    text(byId("record-name"), record.problems.length ? `${record.name}: ${record.problems.join("; ")}` : record.name);
    this.say(Number(this.slider.value));
  }

  say(ms) {
    const at = new Date(ms).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "medium" });
    text(byId("record-at"), at);
    this.slider.setAttribute("aria-valuetext", at);
  }
}
