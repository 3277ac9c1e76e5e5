// SPDX-License-Identifier: Apache-2.0
import type { Subscriber } from "zeromq";
import { BadAnswer, BoardClosed, Timeout } from "./errors.js";

/** What is published, one after the other: `await events.next()`, or `for await`. `close()` ends it. */
export class Events<T> implements AsyncIterable<T> {
  #waiting: T | BadAnswer | undefined; // one: the others wait in the socket, which loses what comes beyond its depth
  #wake: (() => void) | undefined;
  #taken: (() => void) | undefined;
  #ended = false;

  /** `take` makes an event of a message, undefined for one of another kind; `forget` is called at the end. */
  constructor(
    private readonly socket: Subscriber, take: (frames: Buffer[]) => T | undefined, newest = false,
    private readonly forget = (_: Events<T>) => {},
  ) {
    void this.#receive(take, newest);
  }

  /** The next one; `timeout` in seconds, null waits for ever. Rejects with Timeout, BoardClosed, BadAnswer. */
  async next(timeout: number | null = null): Promise<T> {
    const until = timeout === null ? Infinity : performance.now() + timeout * 1000;
    for (;;) {
      const event = this.#waiting;
      this.#waiting = undefined;
      this.#taken?.();
      if (event instanceof BadAnswer) throw event;
      if (event !== undefined) return event;
      if (this.#ended) throw new BoardClosed();
      const left = until - performance.now();
      if (left <= 0) throw new Timeout(`nothing came within ${timeout} s`);
      await this.#wait(left);
    }
  }

  async *[Symbol.asyncIterator](): AsyncIterator<T> {
    while (!this.#ended || this.#waiting !== undefined) {
      try {
        yield await this.next();
      } catch (error) {
        if (error instanceof BoardClosed) return;
        throw error;
      }
    }
  }

  /** Listen no more; twice is fine. */
  close(): void {
    this.#ended = true;
    if (!this.socket.closed) this.socket.close();
    this.#wake?.();
    this.#taken?.();
    this.forget(this);
  }

  async #wait(milliseconds: number): Promise<void> {
    let timer: NodeJS.Timeout | undefined;
    await new Promise<void>((resolve) => {
      this.#wake = resolve;
      if (milliseconds !== Infinity) timer = setTimeout(resolve, milliseconds);
    });
    clearTimeout(timer);
    this.#wake = undefined;
  }

  async #receive(take: (frames: Buffer[]) => T | undefined, newest: boolean): Promise<void> {
    try {
      for await (const frames of this.socket) {
        const event = read(take, frames as Buffer[]);
        if (event === undefined) continue;
        this.#waiting = event;
        this.#wake?.();
        if (!newest) await new Promise<void>((resolve) => { this.#taken = resolve; });
      }
    } catch {
      // closed while it was being read
    }
    this.#ended = true;
    this.#wake?.();
  }
}

function read<T>(take: (frames: Buffer[]) => T | undefined, frames: Buffer[]): T | BadAnswer | undefined {
  try {
    return take(frames);
  } catch (error) {
    return new BadAnswer(`what was published on ${String(frames[0])} cannot be read: ${String(error)}`);
  }
}
