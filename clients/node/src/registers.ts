// SPDX-License-Identifier: Apache-2.0
import type { Board } from "./board.js";
import { part } from "./errors.js";
import type { Events } from "./events.js";
import { count, int, unsigned, type Int } from "./numbers.js";
import { cm } from "./proto/cm.js";

/** Registers' values by name, and the generation that a write made (0 beside values that were read). */
export interface Values {
  readonly values: Readonly<Record<string, Int>>;
  readonly mode: string;
  readonly generation: number;
}

/** Registers (`focus`) and fields (`led.blink`) of the current mode by name. */
export class Registers {
  constructor(private readonly board: Board) {}

  /** Several at once; all that can be read if none is named. */
  async read(...names: string[]): Promise<Readonly<Record<string, Int>>> {
    const { reply } = await this.board.ask("cm_read_reg", cm.ReadReg.encode({ names }).finish());
    return valuesOf(part(reply.registers, "registers")).values;
  }

  /**
   * Several in order, all checked before the first is written: what they hold then. A field's value may have a name
   * (`{"led.blink": "fast"}`). `generation` is what frames after the write have at least.
   */
  async write(values: Readonly<Record<string, Int | string>>): Promise<Values> {
    const writes = Object.entries(values).map(([name, value]): cm.IRegWrite =>
      typeof value === "string" ? { name, named: value } : { name, value: unsigned(value, name) });
    return this.#send(writes);
  }

  /** Only the bits in `mask`. */
  async writeMasked(name: string, value: Int, mask: Int): Promise<Values> {
    return this.#send([{ name, value: unsigned(value, name), mask: unsigned(mask, `${name} (mask)`) }]);
  }

  /** All writes from now on, by any client. */
  events(): Events<Values> {
    return this.board.events(["cm_read_reg"], ([topic, message]) =>
      String(topic) === "cm_read_reg" && message ? valuesOf(cm.RegValues.decode(message)) : undefined);
  }

  async #send(writes: cm.IRegWrite[]): Promise<Values> {
    const message = cm.WriteReg.encode({ writes, lease: this.board.lease }).finish();
    return valuesOf(part((await this.board.ask("cm_write_reg", message)).reply.registers, "registers"));
  }
}

function valuesOf(raw: cm.IRegValues): Values {
  const values = Object.fromEntries((raw.values ?? []).map((v) => [v.name ?? "", int(v.value)]));
  return { values, mode: raw.mode ?? "", generation: count(raw.generation) };
}
