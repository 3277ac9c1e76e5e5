// SPDX-License-Identifier: Apache-2.0
// The boards of a fleet, where the server was given one.

import { byId, empty, h, keyed, text } from "./dom.js";

const STATES = { idle: "idle", partial: "reconfiguring", full: "reconfiguring", error: "error", gone: "gone" };

export class Fleet {
  show(fleet) {
    byId("fleet").hidden = false;
    const there = fleet.boards.filter((board) => board.state !== "gone").length;
    const more = fleet.count > fleet.boards.length ? ` The first ${fleet.boards.length} of ${fleet.count} are shown.` : "";
    const named = listed("Gone", fleet, (board) => board.state === "gone") + listed("Elsewhere than wanted", fleet, apart);
    text(byId("fleet-about"), fleet.problem || `${there} of ${fleet.count} are there. ${named}${more}`);
    const node = byId("fleet-boards");
    keyed(node, fleet.boards, (board) => board.name, (board) => {
      const parts = { loaded: h("span"), labels: h("span", { class: "muted small" }), note: h("span", { class: "muted small" }),
        state: h("span", { class: "pill" }) };
      const line = h("div", { class: "row line", "data-fleet-board": board.name }, h("code", { text: board.name }), parts.state,
        parts.loaded, parts.labels, h("span", { class: "stretch" }), parts.note);
      return { node: line, parts };
    }, ({ parts }, board) => {
      const share = board.fraction === null ? "" : ` ${Math.round(board.fraction * 100)} %`;
      text(parts.state, apart(board) ? "differs" : `${STATES[board.state] ?? board.state}${share}`);
      parts.state.dataset.state = board.state === "gone" || apart(board) ? "error" : board.state;
      const elsewhere = board.wanted && board.wanted !== board.loaded ? ` (wanted: ${board.wanted})` : "";
      text(parts.loaded, (board.loaded || "nothing loaded") + elsewhere);
      text(parts.labels, board.labels.join(" "));
      text(parts.note, board.note);
    });
    empty(node, !fleet.boards.length, "No board's bridge is there.");
  }
}

// Not while it is on its way.
const apart = (board) => board.differs && board.state !== "gone";

function listed(what, fleet, which) {
  const names = fleet.boards.filter(which).map((board) => board.name);
  const shown = names.slice(0, 10).join(", ") + (names.length > 10 ? ` and ${names.length - 10} more` : "");
  return names.length ? `${what}: ${shown}. ` : "";
}
