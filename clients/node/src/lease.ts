// SPDX-License-Identifier: Apache-2.0
import type { Board } from "./board.js";
import { cm } from "./proto/cm.js";

/** A scope that is held; it ends with its time, or when it is given back. */
export class Lease {
  constructor(
    private readonly board: Board, readonly id: string, readonly scope: string, private readonly forget: () => void,
  ) {}

  /** Hold it for so many seconds from now on. */
  async renew(seconds = 60): Promise<void> {
    await this.board.ask("cm_lease", cm.Lease.encode({ id: this.id, seconds }).finish());
  }

  /** Give it back. */
  async release(): Promise<void> {
    this.forget();
    await this.board.ask("cm_lease", cm.Lease.encode({ id: this.id, release: true }).finish());
  }
}
