// SPDX-License-Identifier: Apache-2.0
// The WebSocket: opened again whenever it goes, and what is told and asked over it.

const DENIED = 4401;

export class Link {
  // `on`: {topics(message), picture(header, bytes), state(name), denied()}
  constructor(on) {
    this.on = on;
    this.asked = new Map();
    this.number = 0;
    this.wait = 500;
    this.watched = {};
    this.takeToken();
  }

  takeToken() {
    const given = new URLSearchParams(location.hash.slice(1)).get("token");
    if (given) {
      sessionStorage.setItem("cm-token", given);
      history.replaceState(null, "", location.pathname);
    }
  }

  open() {
    const token = sessionStorage.getItem("cm-token");
    if (!token) return this.on.denied();
    this.on.state("connecting");
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.socket = socket;
      this.send({ token });
    };
    socket.onmessage = (event) => this.take(event.data);
    socket.onclose = (event) => this.closed(event.code);
  }

  take(data) {
    if (typeof data !== "string") {
      const length = new DataView(data).getUint16(0, true);
      const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 2, length)));
      return this.on.picture(header, new Uint8Array(data, 2 + length));
    }
    const message = JSON.parse(data);
    if ("reply" in message) return this.replied(message);
    if (this.wait) {
      this.wait = 0;
      this.on.state("up");
      this.watch(this.watched);
    }
    this.on.topics(message);
  }

  replied({ reply, result, error }) {
    const { resolve, reject } = this.asked.get(reply) ?? {};
    this.asked.delete(reply);
    if (error) reject?.(Object.assign(new Error(error.message), { code: error.code }));
    else resolve?.(result);
  }

  closed(code) {
    this.socket = null;
    for (const { reject } of this.asked.values()) reject(new Error("the connection to the page's server was lost"));
    this.asked.clear();
    if (code === DENIED) {
      sessionStorage.removeItem("cm-token");
      return this.on.denied();
    }
    this.on.state("down");
    this.wait = Math.min(4000, Math.max(500, this.wait * 1.5));
    setTimeout(() => this.open(), this.wait);
  }

  use(token) {
    sessionStorage.setItem("cm-token", token);
    this.open();
  }

  send(message) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  // The streams whose frames are wanted, with how they are drawn.
  watch(streams) {
    this.watched = streams;
    this.send({ watch: streams });
  }

  drawn(stream) {
    this.send({ drawn: stream });
  }

  // Ask for something; the promise is rejected with an Error that has the manager's `code`.
  ask(what, words = {}) {
    return new Promise((resolve, reject) => {
      if (!this.socket) return reject(new Error("not connected"));
      const id = ++this.number;
      this.asked.set(id, { resolve, reject });
      this.send({ do: what, id, with: words });
    });
  }
}
