// SPDX-License-Identifier: Apache-2.0
// The device as a picture, with what is loaded where, and the modes that it can be in.

import { byId, bytes, duration, empty, h, keyed, s, set, text } from "./dom.js";

const [WIDTH, LEFT, BUS, TOP] = [660, 152, 118, 34];
const [TALL, GAP] = [76, 14];
const STACKED = matchMedia("(max-width: 40rem)"); // the processor above the logic, a unit a pixel: text stays as large as it is
const [RAIL, WIRES] = [19, 64]; // of a stacked drawing: a line of the processor's, and the space for streams

export class Device {
  constructor({ ask, control }) {
    Object.assign(this, { ask, control });
    this.picture = s("svg", { class: "device", role: "img", "aria-label": "The device" });
    this.caption = h("p", { class: "muted small" });
    byId("device").append(this.picture, this.caption);
    this.processor = s("g", { class: "processor" });
    this.logic = s("rect", { class: "logic" });
    this.logicName = s("text", { class: "place", x: LEFT + BUS + 14, y: TOP - 12, text: "programmable logic" });
    this.streams = s("g");
    this.regions = s("g");
    this.chip = s("rect", { class: "chip", x: 1, y: 1, rx: 12, width: WIDTH - 2 });
    this.box = s("rect", { class: "block", x: 14, y: TOP, rx: 6, width: LEFT - 14 });
    this.heat = s("text", { class: "heat", x: 28, y: TOP + 36 });
    this.rails = s("g");
    this.processor.append(this.box, s("text", { class: "place", x: 14, y: TOP - 12, text: "processor" }), this.heat, this.rails);
    this.picture.append(
      s("defs", {}, s("pattern", { id: "hatch", width: 8, height: 8, patternUnits: "userSpaceOnUse" },
        s("path", { d: "M0 8L8 0M-2 2L2 -2M6 10L10 6", class: "hatch" }))),
      this.chip, this.processor, this.logic, this.logicName, this.regions, this.streams,
    );
    new ResizeObserver(() => STACKED.matches && this.last && this.show(this.last)).observe(byId("device"));
    STACKED.addEventListener("change", () => this.last && this.show(this.last));
  }

  // Where things stand: beside each other, or on a phone one above the other.
  place(status) {
    const sensors = status.sensors.filter((sensor) => sensor.quantity !== "temperature");
    if (!STACKED.matches) {
      const lines = Math.max(status.regions.length, Math.ceil(status.streams.length / 2), 1);
      const tall = lines * (TALL + GAP) - GAP + 28;
      const x = LEFT + BUS;
      return { width: WIDTH, height: TOP + tall + 16, box: { x: 14, y: TOP, width: LEFT - 14, height: tall },
        logic: { x, y: TOP, width: WIDTH - x - 14, height: tall }, rails: sensors.slice(0, Math.floor((tall - 60) / RAIL)) };
    }
    const width = Math.max(240, byId("device").clientWidth);
    const box = { x: 12, y: TOP, width: width - 24, height: 50 + RAIL * sensors.length };
    const y = TOP + box.height + (status.streams.length ? WIRES : 12) + 22;
    const logic = { x: 12, y, width: width - 24, height: Math.max(status.regions.length, 1) * (TALL + GAP) - GAP + 28 };
    return { width, height: logic.y + logic.height + 14, box, logic, rails: sensors };
  }

  show(state) {
    const { status, config, configs } = state;
    if (!status) return;
    this.last = state;
    const at = this.place(status);
    set(this.picture, "viewBox", `0 0 ${at.width} ${at.height}`);
    for (const [node, place] of [[this.box, at.box], [this.logic, { ...at.logic, rx: 6 }],
      [this.chip, { width: at.width - 2, height: at.height - 2 }], [this.logicName, { x: at.logic.x + (STACKED.matches ? 0 : 14), y: at.logic.y - 12 }]]) {
      for (const [name, value] of Object.entries(place)) set(node, name, value);
    }
    const heat = status.sensors.find((sensor) => sensor.quantity === "temperature");
    text(this.heat, heat ? `${heat.value.toFixed(1)} °C` : "");
    this.showRegions(status, at.logic);
    this.showStreams(status.streams, at);
    set(this.picture, "aria-label", describe(status));
    const clocks = status.clocks.map((clock) => `${clock.name} ${(clock.rate || clock.wanted) / 1e6} MHz`);
    const overlays = config?.modes.find((mode) => mode.name === status.mode)?.overlays ?? [];
    this.showRails(at.rails, at.box);
    text(this.caption, [...overlays.map((name) => `overlay ${name}`), ...clocks].join(" · "));
    this.showModes(status, config, configs ?? {});
  }

  showRails(sensors, box) {
    const shown = sensors.map((sensor, index) => ({ ...sensor, y: TOP + 62 + RAIL * index }));
    keyed(this.rails, shown, (sensor) => `${sensor.device} ${sensor.name}`, (sensor) => {
      const parts = { name: s("text", { class: "name", x: 28, text: sensor.name }),
        value: s("text", { class: "rail", "text-anchor": "end" }) };
      return { node: s("g", {}, parts.name, parts.value), parts };
    }, ({ parts }, sensor) => {
      set(parts.name, "y", sensor.y);
      set(parts.value, "y", sensor.y);
      set(parts.value, "x", box.x + box.width - 10);
      text(parts.value, `${sensor.value.toFixed(2)} ${UNITS[sensor.quantity] ?? ""}`);
    });
  }

  showRegions(status, logic) {
    const x = logic.x + 14;
    const width = logic.width - 28;
    const each = status.regions.length ? Math.min(TALL, (logic.height - 28 + GAP) / status.regions.length - GAP) : TALL;
    keyed(this.regions, status.regions.map((region, index) => ({ ...region, y: logic.y + 14 + index * (each + GAP) })),
      (region) => region.name, (region) => {
        const parts = {
          box: s("rect", { rx: 6 }), cut: s("rect", { class: "cut", rx: 6, fill: "url(#hatch)" }),
          bar: s("rect", { class: "bar", height: 4, rx: 2 }),
          name: s("text", { class: "name", text: region.name }), module: s("text", { class: "module" }),
          state: s("text", { class: "state", "text-anchor": "end" }),
        };
        return { node: s("g", {}, ...Object.values(parts)), parts };
      }, ({ node, parts }, region) => {
        const upset = region.health?.wrong_bits;
        node.setAttribute("class", `region ${upset ? "failed" : region.state}`);
        node.dataset.region = region.name;
        for (const part of [parts.box, parts.cut]) for (const [name, value] of Object.entries({ x, width, y: region.y, height: each })) set(part, name, value);
        set(parts.bar, "x", x);
        for (const part of [parts.name, parts.module]) set(part, "x", x + 14);
        set(parts.state, "x", x + width - 14);
        const progress = status.progress;
        const loads = progress?.step === "load" && progress.subject === region.name && progress.bytes_total;
        set(parts.bar, "y", region.y + each - 4);
        set(parts.bar, "width", loads ? (width * progress.bytes_done) / progress.bytes_total : 0);
        set(parts.name, "y", region.y + 22);
        set(parts.module, "y", region.y + 50);
        set(parts.state, "y", region.y + 22);
        text(parts.module, region.module ?? "—");
        text(parts.state, upset ? `${upset} bits wrong` : region.state);
      });
  }

  showStreams(streams, { box, logic }) {
    const stacked = STACKED.matches;
    const step = (stacked ? logic.width : logic.height) / (streams.length + 1);
    keyed(this.streams, streams.map((stream, index) => ({ ...stream, along: step * (index + 1) })), (stream) => stream.name, (stream) => {
      const line = s("path", { class: "wire" });
      const label = s("text", { class: "name", "text-anchor": "middle", text: stream.name });
      return { node: s("g", {}, line, label), line, label };
    }, (row, stream) => {
      const out = stream.direction === "s2mm"; // of the logic
      row.node.setAttribute("class", `stream ${stream.open ? "open" : "closed"}`);
      if (stacked) {
        const [x, top, foot] = [logic.x + stream.along, box.y + box.height + 6, logic.y - 30];
        const tip = out ? 7 : -7;
        set(row.line, "d", `M${x} ${out ? foot : top}V${out ? top : foot}m-5 ${tip}l5 ${-tip}l5 ${tip}`);
        set(row.label, "x", x);
        set(row.label, "y", logic.y - 14);
      } else {
        const y = TOP + stream.along;
        const [from, to] = out ? [LEFT + BUS - 4, LEFT + 6] : [LEFT + 4, LEFT + BUS - 6];
        const tip = from < to ? -7 : 7;
        set(row.line, "d", `M${from} ${y}H${to}m${tip} -5l${-tip} 5l${tip} 5`);
        set(row.label, "x", LEFT + BUS / 2);
        set(row.label, "y", y - 7);
      }
    });
    set(this.logicName, "visibility", stacked && streams.length ? "hidden" : "visible"); // the streams' names stand there
  }

  // ---- modes --------------------------------------------------------------------------

  showModes(status, config, configs) {
    const groups = Object.entries(configs);
    keyed(byId("modes"), groups, ([name]) => name, ([name]) => {
      const list = h("ul", { class: "modes" });
      const title = h("h3");
      return { node: h("div", { class: "config", "data-config": name }, title, list), title, list };
    }, (row, [name, { type, modes }]) => {
      text(row.title, `${name} · ${type}`);
      row.title.hidden = groups.length < 2;
      keyed(row.list, modes, (mode) => mode.name, (mode) => this.makeMode(name, mode), (item, mode) => {
        this.updateMode(item, status, name, mode);
      });
    });
    empty(byId("modes"), !groups.length, "No configuration is known.");
    if (!config && status.config_name) text(byId("modes"), "");
  }

  makeMode(config, mode) {
    const go = h("button", { type: "button", class: "go", onclick: () => {
      if (go.getAttribute("aria-disabled") !== "true") this.ask("mode", { config, mode: mode.name }, go);
    } });
    const plan = h("div", { class: "plan" });
    const details = h("details", { ontoggle: () => details.open && this.plan(config, mode.name, plan) },
      h("summary", { text: "plan" }), plan);
    const modules = h("span", { class: "chips" }, ...mode.modules.map((name) => h("span", { class: "chip", text: name })));
    const node = h("li", { "data-mode": mode.name }, h("div", { class: "row" }, go, modules, details), plan);
    plan.hidden = true;
    details.addEventListener("toggle", () => (plan.hidden = !details.open));
    return { node, go, details, plan };
  }

  updateMode({ node, go, details, plan }, status, config, mode) {
    const here = status.config_name === config && status.mode === mode.name;
    const target = status.progress?.target_config === config && status.progress?.target_mode === mode.name;
    node.dataset.here = here;
    node.dataset.target = target;
    text(go, mode.name);
    set(go, "aria-current", here ? "true" : null);
    const off = !this.control() || status.fpga_busy || here;
    set(go, "aria-disabled", off ? "true" : null); // not `disabled`: the focus stays where Enter was pressed
    go.title = here ? "loaded" : off ? "" : `Change to ${config}/${mode.name}`;
    const stamp = `${status.config_name}/${status.mode}/${status.last_change}`;
    if (details.open && !status.fpga_busy && plan.dataset.stamp !== stamp) {
      plan.dataset.stamp = stamp;
      this.plan(config, mode.name, plan);
    }
  }

  async plan(config, mode, node) {
    const plan = await this.ask("plan", { config, mode }, node);
    if (plan === undefined) return node.replaceChildren();
    const steps = plan.steps.map((step) => h("li", {}, h("span", { text: step.text }),
      h("span", { class: "muted", text: step.seconds ? duration(step.seconds) : "" })));
    return node.replaceChildren(h("ol", {}, ...steps),
      h("p", { class: "muted", text: `${bytes(plan.bytes)} to load, ${duration(plan.seconds)} expected` }));
  }
}

const UNITS = { voltage: "V", current: "A", power: "W" };

function describe(status) {
  const regions = status.regions.map((region) => `region ${region.name} holds ${region.module ?? "nothing known"}, ${region.health?.wrong_bits ? `${region.health.wrong_bits} bits wrong` : region.state}`);
  const streams = status.streams.map((stream) => `stream ${stream.name} ${stream.open ? "runs" : "does not run"}`);
  return `The device: ${[...regions, ...streams].join("; ")}`;
}
