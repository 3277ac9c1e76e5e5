// SPDX-License-Identifier: Apache-2.0
import type { Board } from "./board.js";
import { CmError, Timeout } from "./errors.js";
import { Events } from "./events.js";
import { frameOf, type Frame } from "./frame.js";
import type { Link } from "./link.js";
import { cm } from "./proto/cm.js";

export interface StreamOptions {
  /** Skip what waits behind a newer frame. */
  readonly newest?: boolean;
  /** Frames that may wait here, beside those at the manager. */
  readonly depth?: number;
  /** Seconds that a read waits; null: for ever. */
  readonly timeout?: number | null;
}

/** Frames of one stream: `await stream.read()`, or `for await`. */
export class FrameStream implements AsyncIterable<Frame> {
  /** Frames that are missing between those that came. */
  lost = 0;
  #events: Events<Frame> | undefined;
  #expected: number | undefined;
  #closed = false;
  readonly #timeout: number | null;

  constructor(
    private readonly board: Board, private readonly link: Link, readonly name: string,
    private readonly options: StreamOptions, private readonly forget: (it: FrameStream) => void,
  ) {
    this.#timeout = options.timeout === undefined ? board.timeout : options.timeout;
  }

  /** Listen; `read` does it by itself. Rejects for an unknown stream. */
  async open(): Promise<void> {
    if (this.#closed) throw new CmError("closed", `the stream ${this.name} was closed: ask for another`);
    if (this.#events) return;
    await this.board.configureStream(this.name);
    const topic = `cm_stream/${this.name}`;
    // subscriptions match by prefix: frames of "camera2" also reach subscribers of "camera"
    const take = ([at, message, payload]: Buffer[]) =>
      String(at) === topic && message && payload ? frameOf(cm.Frame.decode(message), payload) : undefined;
    if (this.#closed) return this.open(); // meanwhile
    this.#events = new Events(this.link.subscribe([topic], this.options.depth ?? 4), take, this.options.newest ?? false);
  }

  /** The next frame; `timeout` in seconds, null waits for ever. */
  async read(timeout: number | null = this.#timeout): Promise<Frame> {
    await this.open();
    let frame: Frame;
    try {
      frame = await this.#events!.next(timeout);
    } catch (error) {
      if (error instanceof Timeout) throw new Timeout(`stream ${this.name} gave no frame within ${timeout} s`);
      throw error;
    }
    if (this.#expected !== undefined && frame.sequence > this.#expected) this.lost += frame.sequence - this.#expected;
    this.#expected = frame.sequence + 1;
    return frame;
  }

  /** The first frame that began after a write was done: `stream.after(await board.registers.write(…))`. */
  async after(write: { readonly generation: number }, timeout: number | null = this.#timeout): Promise<Frame> {
    const until = timeout === null ? Infinity : performance.now() + timeout * 1000;
    for (;;) {
      const left = until === Infinity ? null : Math.max(0, until - performance.now()) / 1000;
      const frame = await this.read(left);
      if (frame.generation >= write.generation) return frame;
    }
  }

  async *[Symbol.asyncIterator](): AsyncIterator<Frame> {
    for (;;) yield await this.read();
  }

  /** Listen no more, for good; twice is fine. */
  close(): void {
    this.#closed = true;
    this.#events?.close();
    this.#events = undefined;
    this.forget(this);
  }
}
