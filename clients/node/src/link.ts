// SPDX-License-Identifier: Apache-2.0
import { Dealer, Subscriber } from "zeromq";
import type { Endpoints, Keys } from "./address.js";
import { BadAnswer, BoardClosed, ConnectionLost, KeyRefused, RequestFailed, Timeout, part } from "./errors.js";
import { cm } from "./proto/cm.js";

/** A reply, and the payload frames behind it. */
export interface Answer {
  readonly reply: cm.Reply;
  readonly payload: Buffer[];
}

interface Pending {
  resolve(answer: Answer): void;
  reject(error: Error): void;
  timer: NodeJS.Timeout | undefined;
}

const EMPTY = Buffer.alloc(0);

/**
 * Over ipc the next try comes after 10 ms, not 100: where others connect without end, a place is free now and then. No
 * frame of a stream is longer than 1 GiB; libzmq makes room for what is announced.
 */
const usual = (address: string) => ({
  linger: 0, maxMessageSize: 2 ** 30 + 2 ** 20, ...(address.startsWith("ipc:") ? { reconnectInterval: 10 } : {}),
});

/** Requests on a DEALER, each with a number of its own, so that a late reply is never taken for that of another. */
export class Link {
  readonly #socket: Dealer;
  readonly #pending = new Map<string, Pending>();
  readonly #between: readonly (string | Buffer)[]; // the number of a request and its topic
  #last = 0;
  #up = false;
  #sending: Promise<unknown> = Promise.resolve();
  #ended: Error | undefined;

  /** `guest`: in whose name a bridge asks. */
  constructor(
    private readonly endpoints: Endpoints, private readonly keys: Keys | undefined, private readonly guest = "",
  ) {
    if (guest.length > 64) throw new RangeError(`${guest}: a guest's name has at most 64 characters`);
    this.#between = guest ? [`for=${guest}`, EMPTY] : [EMPTY];
    this.#socket = new Dealer({ receiveHighWaterMark: 0, ...usual(endpoints.req), ...curve(keys) });
    const { events } = this.#socket;
    events.on("handshake", () => { this.#up = true; });
    events.on("disconnect", () => this.#lose());
    for (const failure of ["auth", "protocol", "other"] as const) {
      events.on(`handshake:error:${failure}`, () => this.#refused(failure));
    }
    this.#socket.connect(endpoints.req);
    void this.#receive();
  }

  /** Ask; `timeout` in seconds, null waits for ever. Rejects with RequestFailed, Timeout, ConnectionLost, BoardClosed. */
  ask(topic: string, message: Uint8Array, payload: readonly Uint8Array[], timeout: number | null): Promise<Answer> {
    if (this.#ended) return Promise.reject(this.#ended);
    const number = String(++this.#last);
    const answer = new Promise<Answer>((resolve, reject) => {
      const expired = () => {
        this.#pending.delete(number);
        reject(new Timeout(`no answer from a configuration manager at ${this.endpoints.req} within ${timeout} s`));
      };
      const timer = timeout === null ? undefined : setTimeout(expired, timeout * 1000);
      this.#pending.set(number, { resolve, reject, timer });
    });
    // one after the other: the socket takes one message at a time
    this.#sending = this.#sending.then(() => this.#socket.send([number, ...this.#between, topic, message, ...payload]))
      .catch((error: unknown) => this.#take(number)?.reject(error as Error));
    return answer;
  }

  /** What is published on some topics, from when the manager knows of it on. */
  subscribe(topics: readonly string[], depth = 1000): Subscriber {
    if (this.#ended) throw this.#ended;
    if (this.guest) {
      throw new Error(`what is published is handed to the bridge, not to ${this.guest}: subscribe without a guest, ` +
        "and hold back what is not for it");
    }
    const options = { receiveHighWaterMark: depth, ...usual(this.endpoints.pub), ...curve(this.keys) };
    const socket = new Subscriber(options);
    socket.subscribe(...topics);
    socket.connect(this.endpoints.pub);
    return socket;
  }

  close(): void {
    if (this.#socket.closed) return;
    this.#end(new BoardClosed());
    this.#socket.close();
  }

  async #receive(): Promise<void> {
    try {
      for await (const [number, ...frames] of this.#socket) {
        const [, message, ...payload] = frames.slice(this.#between.length);
        const pending = this.#take(String(number));
        if (!pending) continue;
        try {
          const reply = cm.Reply.decode(part(message, "a message"));
          if (reply.ok) pending.resolve({ reply, payload });
          else pending.reject(new RequestFailed(reply.error?.code ?? "", reply.error?.message ?? "refused"));
        } catch (error) {
          pending.reject(error instanceof BadAnswer ? error : new BadAnswer(`the manager's answer cannot be read: ${String(error)}`));
        }
      }
    } catch (error) {
      if (!this.#socket.closed) this.#end(error as Error);
    }
  }

  #take(number: string): Pending | undefined {
    const pending = this.#pending.get(number);
    this.#pending.delete(number);
    clearTimeout(pending?.timer);
    return pending;
  }

  /** The socket would try for ever, and nothing would ever come. */
  #refused(failure: string): void {
    const why = failure === "auth" ? "does not know our key" : "and we do not agree on keys";
    this.#rejectAll(new KeyRefused(`the configuration manager at ${this.endpoints.req} ${why}`));
  }

  /** Tell those that wait; the socket reconnects by itself. Before the first connection, the manager is merely not there yet. */
  #lose(): void {
    if (!this.#up) return;
    this.#up = false;
    this.#rejectAll(new ConnectionLost(`the configuration manager at ${this.endpoints.req} went away`));
  }

  #end(error: Error): void {
    this.#ended = error;
    this.#rejectAll(error);
  }

  #rejectAll(error: Error): void {
    for (const number of [...this.#pending.keys()]) this.#take(number)?.reject(error);
  }
}

function curve(keys: Keys | undefined) {
  if (!keys) return {};
  return { curveServerKey: keys.serverPublic, curvePublicKey: keys.public, curveSecretKey: keys.secret };
}
