// SPDX-License-Identifier: Apache-2.0
import type { Subscriber } from "zeromq";
import { BoardClosed, Timeout } from "./errors.js";

/** What is published, one after the other: `await events.next()`, or `for await`. `close()` ends it. */
export class Events<T> implements AsyncIterable<T> {
  readonly #waiting: T[] = [];
  #wake: (() => void) | undefined;
  #ended = false;

  /** `take` makes an event of a message, undefined for one of another kind. */
  constructor(private readonly socket: Subscriber, take: (frames: Buffer[]) => T | undefined, newest = false) {
    void this.#receive(take, newest);
  }

  /** The next one; `timeout` in seconds, null waits for ever. Rejects with Timeout, BoardClosed. */
  async next(timeout: number | null = null): Promise<T> {
    const until = timeout === null ? Infinity : performance.now() + timeout * 1000;
    for (;;) {
      const event = this.#waiting.shift();
      if (event !== undefined) return event;
      if (this.#ended) throw new BoardClosed();
      const left = until - performance.now();
      if (left <= 0) throw new Timeout(`nothing came within ${timeout} s`);
      await this.#wait(left);
    }
  }

  async *[Symbol.asyncIterator](): AsyncIterator<T> {
    while (!this.#ended || this.#waiting.length > 0) {
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
        const event = take(frames as Buffer[]);
        if (event === undefined) continue;
        if (newest) this.#waiting.length = 0;
        this.#waiting.push(event);
        this.#wake?.();
      }
    } catch {
      // closed while it was being read
    }
    this.#ended = true;
    this.#wake?.();
  }
}
