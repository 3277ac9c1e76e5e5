// SPDX-License-Identifier: Apache-2.0
// The page: what the server tells goes to the panels that show it.

import { byId, text } from "./dom.js";
import { Link } from "./link.js";
import { Streams } from "./streams.js";
import { Device } from "./device.js";
import { Maps } from "./maps.js";
import { Changes } from "./changes.js";
import { Registers } from "./registers.js";
import { Notices } from "./notices.js";
import { Charts } from "./charts.js";
import { Errors } from "./errors.js";
import { Fleet } from "./fleet.js";
import { RecordTime } from "./record.js";
import { theme } from "./theme.js";

const state = { link: { up: false, control: false }, server: "connecting" };

const link = new Link({
  topics(message) {
    Object.assign(state, message);
    for (const topic of Object.keys(message)) handlers[topic]?.(message[topic]);
    if ("link" in message || "status" in message) head();
  },
  picture: (header, payload) => streams.picture(header, payload),
  state(name) {
    state.server = name;
    head();
  },
  denied() {
    state.server = "denied";
    head();
    byId("ask").showModal();
  },
});

const control = () => state.link.control && state.link.up && state.server === "up";
const errors = new Errors();
// Ask the board, by the control `node`. What it refuses is told in the one place for errors, and the answer is undefined.
const ask = (what, words, node) => link.ask(what, words).then(
  (value) => { errors.done(node); return value ?? true; },
  (error) => errors.refused(error, node),
);
const streams = new Streams(byId("streams"), link);
const device = new Device({ ask, control });
const maps = new Maps({ ask, control });
const changes = new Changes({ ask, control });
const registers = new Registers(byId("registers"), { ask, control });
const notices = new Notices();
const charts = new Charts(byId("charts"));
const fleet = new Fleet();
const record = new RecordTime(ask);

const handlers = {
  link() {
    record.show(state.link.record);
    device.show(state);
    maps.show(state);
    registers.show(state);
    changes.show(state);
  },
  status() {
    streams.show(state);
    device.show(state);
    maps.show(state);
    changes.show(state);
    notices.leases(state.status);
  },
  watched: () => streams.show(state),
  config() {
    device.show(state);
    registers.show(state);
  },
  configs: () => device.show(state),
  registers: () => registers.show(state),
  interrupts: () => notices.interrupts(state.interrupts),
  errors: () => errors.board(state.errors),
  changes() {
    changes.show(state);
    const { at, seconds, state: how } = state.changes.at(-1) ?? {};
    if (how === "done") errors.settled(at + seconds);
  },
  fleet: () => fleet.show(state.fleet),
  history: (points) => charts.begin(points),
  point: (point) => charts.add(point),
};

const STATES = { idle: "idle", partial: "reconfiguring", full: "reconfiguring", error: "error" };

function head() {
  const { status, link: manager, server } = state;
  const up = server === "up" && manager.up;
  document.body.dataset.link = up ? "up" : server === "up" ? "manager" : server;
  text(byId("link"), up && manager.record ? "a record" : up ? "connected" : server === "up" ? "no manager" : server === "denied" ? "no token" : "connecting …");
  byId("link").title = up ? "" : manager.problem || "";
  text(byId("rights"), state.link.control ? "" : "read-only");
  banner(server === "up" ? (manager.up || state.fleet ? "" : manager.problem) : "", server === "down");
  if (!status) return;
  text(byId("board"), status.board || "fpga-cm");
  document.title = `${status.board}: ${status.mode || "nothing loaded"}`;
  text(byId("about"), `fpga-cm ${status.version} · since ${new Date(status.started_ns / 1e6).toLocaleString()}`);
  text(byId("loaded"), status.config_name ? `${status.config_name} / ${status.mode || "—"}` : "nothing loaded");
  const pill = byId("state");
  const upset = !status.fpga_busy && status.regions.find((region) => region.health?.wrong_bits);
  text(pill, upset ? `${upset.name} is wrong` : STATES[status.pr_mode] ?? status.pr_mode);
  pill.dataset.state = upset ? "error" : status.pr_mode;
}

// What is missing between the page and the board, and what to do about it.
function banner(problem, isAlone) {
  byId("banner").hidden = !problem && !isAlone;
  text(byId("missing"), isAlone ? "The page's server is not there. What you see is as it was." : "No manager.");
  text(byId("why"), isAlone ? "" : problem);
  byId("remedy").hidden = isAlone;
  byId("again").hidden = !isAlone;
}

byId("refresh").addEventListener("click", () => ask("read", {}, byId("refresh")));
byId("ask").addEventListener("close", () => byId("token").value && link.use(byId("token").value.trim()));
theme(byId("theme"), () => charts.draw());
link.open();
