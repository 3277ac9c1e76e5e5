// SPDX-License-Identifier: Apache-2.0
import type { Endpoints, Keys } from "./address.js";
import { endpoints, loadKeys } from "./address.js";
import { part } from "./errors.js";
import { Events } from "./events.js";
import { frameOf, type Frame } from "./frame.js";
import { Lease } from "./lease.js";
import { Link, type Answer } from "./link.js";
import { count, unsigned } from "./numbers.js";
import { cm } from "./proto/cm.js";
import { Registers } from "./registers.js";
import { statusOf, type Progress, type Status } from "./status.js";
import { FrameStream, type StreamOptions } from "./stream.js";

export interface ConnectOptions {
  /** CURVE keys, or the file of a client that `cm keygen` wrote; TCP beyond one machine needs them. */
  readonly keys?: Keys | string;
  /** Seconds that a request waits for its answer. Changes of mode wait for ever unless told otherwise. */
  readonly timeout?: number;
  /** In whose name all is asked, by a bridge that may speak for it (docs/security.md, Bridges); no subscriptions then. */
  readonly guest?: string;
}

export interface LoadOptions {
  /** Load what is loaded already. */
  readonly force?: boolean;
  /** Refused as `busy` rather than wait for a change that runs. */
  readonly queue?: boolean;
  /** Told of each step. */
  readonly progress?: (progress: Progress) => void;
  /** Seconds; null waits for ever. */
  readonly timeout?: number | null;
}

export interface Interrupt {
  readonly name: string;
  readonly count: number;
  readonly timestampNs: number;
}

/** Connect to a manager: `tcp://host[:port]`, a runtime folder, or this machine's. Nothing is sent yet. */
export function connect(address?: string, options: ConnectOptions = {}): Board {
  const keys = typeof options.keys === "string" ? loadKeys(options.keys) : options.keys;
  return new Board(endpoints(address), keys, options.timeout ?? 5, options.guest);
}

/** A board, by way of its manager. Methods reject with RequestFailed, Timeout, ConnectionLost, BoardClosed. */
export class Board {
  readonly registers: Registers;
  readonly #link: Link;
  readonly #leases = new Set<string>();
  readonly #waited = new Map<string, number>(); // by interrupt: the time of the one that ended the last wait
  readonly #open = new Set<{ close(): void }>();

  constructor(endpoints: Endpoints, keys: Keys | undefined, readonly timeout: number, guest = "") {
    this.#link = new Link(endpoints, keys, guest);
    this.registers = new Registers(this);
  }

  // ---- state and changes ----------------------------------------------------------------------

  async status(): Promise<Status> {
    const { reply } = await this.ask("cm_status", cm.ReadStatus.encode({}).finish());
    return statusOf(part(reply.status, "a status"));
  }

  /** Statuses, the current one first, then whenever it changes. */
  watch(): Events<Status> {
    return this.events(["cm_status"], ([topic, message]) =>
      String(topic) === "cm_status" && message ? statusOf(cm.Status.decode(message)) : undefined);
  }

  /** All configurations with their modes. */
  async configs(): Promise<readonly cm.IConfigEntry[]> {
    const { reply } = await this.ask("cm_read_config", cm.ReadConfig.encode({ list: true }).finish());
    return part(reply.config, "configurations").entries ?? [];
  }

  /** A configuration; the loaded one without a name. */
  async config(name = ""): Promise<cm.IConfig> {
    const { reply } = await this.ask("cm_read_config", cm.ReadConfig.encode({ configName: name }).finish());
    return part(reply.config, "a configuration");
  }

  /** What going to a mode would do. */
  async plan(mode = "", config = ""): Promise<cm.IPlan> {
    const message = cm.ReadConfig.encode({ configName: config, planMode: mode, plan: true }).finish();
    return part((await this.ask("cm_read_config", message)).reply.plan, "a plan");
  }

  /** Go to a mode of the loaded configuration; the seconds that it took. */
  setMode(mode: string, options: LoadOptions = {}): Promise<number> {
    return this.load("", mode, options);
  }

  /** Load a configuration in a mode (its default one without a name); the seconds that it took. */
  async load(config: string, mode = "", options: LoadOptions = {}): Promise<number> {
    const message = cm.WriteConfig.encode({
      configName: config, mode, force: options.force ?? false, noQueue: options.queue === false, lease: this.lease,
    }).finish();
    const ask = async () => part((await this.ask("cm_write_config", message, [], options.timeout ?? null)).reply.change, "a change");
    return (await (options.progress ? this.#told(ask, options.progress) : ask())).seconds ?? 0;
  }

  /** Cancel the change that runs, before its next load; the board goes back. */
  async cancel(): Promise<void> {
    await this.ask("cm_write_config", cm.WriteConfig.encode({ cancel: true }).finish());
  }

  /**
   * A change, with its progress: from the first status on we are listened to. The last may come after the reply; what
   * comes later than the time-out of requests is not told.
   */
  async #told(ask: () => Promise<cm.IChange>, progress: (progress: Progress) => void): Promise<cm.IChange> {
    const statuses = this.watch();
    try {
      await statuses.next(this.timeout);
      const told = { last: 0, until: Infinity };
      const telling = this.#tell(statuses, progress, told);
      const change = await ask();
      told.until = count(change.number);
      const late = new Promise((resolve) => setTimeout(resolve, this.timeout * 1000).unref());
      if (told.last < told.until) await Promise.race([telling, late]);
      return change;
    } finally {
      statuses.close();
    }
  }

  async #tell(
    statuses: Events<Status>, progress: (progress: Progress) => void, told: { last: number; until: number },
  ): Promise<void> {
    for await (const status of statuses) {
      if (status.progress) progress(status.progress);
      told.last = status.lastChange;
      if (told.last >= told.until) return;
    }
  }

  // ---- leases and interrupts ------------------------------------------------------------------

  /** Hold a scope ("board", "config", "region:NAME", "registers:NAME", "memories:NAME"); our own calls pass. */
  async takeLease(scope: string, { seconds = 60, exclusive = true, holder = "node" } = {}): Promise<Lease> {
    const message = cm.Lease.encode({ scope, seconds, exclusive, holder }).finish();
    const { reply } = await this.ask("cm_lease", message);
    const id = part(reply.lease?.id, "a lease");
    this.#leases.add(id);
    return new Lease(this, id, scope, () => this.#leases.delete(id));
  }

  /** The ids of our leases, as requests carry them. */
  get lease(): string {
    return [...this.#leases].join(",");
  }

  /** Count and time of an interrupt since the configuration was loaded. */
  async interrupt(name: string): Promise<Interrupt> {
    const { reply } = await this.ask("cm_irq", cm.ReadIrq.encode({ name }).finish());
    return interruptOf(part(reply.irq, "an interrupt"));
  }

  /**
   * Wait for one since our last wait, or since the configuration was loaded; it may have come already. `timeout` in
   * seconds, null waits for ever. Rejects with Timeout.
   */
  async waitInterrupt(name: string, timeout: number | null = null): Promise<Interrupt> {
    const until = timeout === null ? null : performance.now() + timeout * 1000;
    const told = this.events(["cm_irq", "cm_status"], ([topic, message]): Interrupt | "settled" | undefined => {
      if (String(topic) === "cm_status") return "settled"; // the manager has our subscriptions
      const irq = message && interruptOf(cm.Irq.decode(message));
      return irq && irq.name === name ? irq : undefined;
    });
    try {
      while (await told.next(Math.max(this.timeout, timeout ?? 0)) !== "settled");
      let came = await this.interrupt(name);
      const latest = came.timestampNs;
      while (came.count === 0 || came.timestampNs === (this.#waited.get(name) ?? 0)) {
        const event = await told.next(until === null ? null : Math.max(0, until - performance.now()) / 1000);
        if (event !== "settled" && event.timestampNs > latest) came = event;
      }
      this.#waited.set(name, came.timestampNs);
      return came;
    } finally {
      told.close();
    }
  }

  /** Each interrupt of one name. */
  interrupts(name: string): Events<Interrupt> {
    return this.events(["cm_irq"], ([topic, message]) => {
      if (String(topic) !== "cm_irq" || !message) return undefined;
      const irq = interruptOf(cm.Irq.decode(message));
      return irq.name === name ? irq : undefined;
    });
  }

  // ---- data -----------------------------------------------------------------------------------

  /** Frames of a stream as copies; the manager runs it while anyone listens. */
  stream(name: string, options: StreamOptions = {}): FrameStream {
    const stream = new FrameStream(this, this.#link, name, options, (it) => this.#open.delete(it));
    this.#open.add(stream);
    return stream;
  }

  /** The next frame of a stream from now on. `timeout` in seconds. */
  async read(stream: string, timeout = this.timeout): Promise<Frame> {
    const message = cm.ReadData.encode({ stream, timeout }).finish();
    const { reply, payload } = await this.ask("cm_read_data", message, [], timeout + this.timeout);
    return frameOf(part(reply.frame, "a frame"), part(payload[0], "its bytes"));
  }

  /** Send a frame to the hardware; settled when it has taken it. */
  async write(stream: string, data: ArrayBufferView): Promise<void> {
    const bytes = new Uint8Array(data.buffer, data.byteOffset, data.byteLength);
    await this.ask("cm_write_data", cm.WriteData.encode({ stream, lease: this.lease }).finish(), [bytes], this.timeout + 5);
  }

  /** What is set of a stream, or, with settings, is set from now on. */
  async configureStream(stream: string, settings: Omit<cm.IDataConfig, "stream"> = {}): Promise<cm.IStreamState> {
    const message = cm.DataConfig.encode({ lease: this.lease, ...settings, stream }).finish();
    return part((await this.ask("cm_data_config", message)).reply.stream, "a stream");
  }

  /** Bytes of a memory, from `offset` on; `length` 0: the rest. Multiples of 4. */
  async readMemory(name: string, offset = 0, length = 0): Promise<Frame> {
    const { reply, payload } = await this.ask("cm_read_data", readMemory(name, offset, length));
    return frameOf(part(reply.frame, "a frame"), part(payload[0], "its bytes"));
  }

  /** Bytes for a memory; settled when they are there. */
  async writeMemory(name: string, data: ArrayBufferView, offset = 0): Promise<void> {
    const bytes = new Uint8Array(data.buffer, data.byteOffset, data.byteLength);
    const message = cm.WriteData.encode({ stream: name, lease: this.lease, offset: longOf(offset) }).finish();
    await this.ask("cm_write_data", message, [bytes]);
  }

  // ---- for what is not here yet ---------------------------------------------------------------

  /** A request by its topic and message: what the protocol has and this class has not. */
  ask(topic: string, message: Uint8Array, payload: readonly Uint8Array[] = [], timeout: number | null = this.timeout): Promise<Answer> {
    return this.#link.ask(topic, message, payload, timeout);
  }

  /** What is published on some topics. */
  events<T>(topics: readonly string[], take: (frames: Buffer[]) => T | undefined): Events<T> {
    const events = new Events(this.#link.subscribe(topics), take, false, (it) => this.#open.delete(it));
    this.#open.add(events);
    return events;
  }

  /** Disconnect; whatever is asked afterwards rejects with BoardClosed. Twice is fine. */
  close(): void {
    for (const open of this.#open) open.close();
    this.#open.clear();
    this.#link.close();
  }
}

function interruptOf(irq: cm.IIrq): Interrupt {
  return { name: irq.name ?? "", count: count(irq.count), timestampNs: count(irq.timestampNs) };
}

function readMemory(stream: string, offset: number, length: number): Uint8Array {
  return cm.ReadData.encode({ stream, offset: longOf(offset), length: longOf(length) }).finish();
}

function longOf(value: number) {
  return unsigned(value, "a place in a memory");
}
