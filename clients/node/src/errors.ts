// SPDX-License-Identifier: Apache-2.0

/** What the manager refused, or a client met: `code` is stable (docs/reconfiguration.md lists those of the manager). */
export class CmError extends Error {
  constructor(readonly code: string, message: string) {
    super(message);
    this.name = new.target.name;
  }
}

/** The manager refused a request. */
export class RequestFailed extends CmError {}

/** Nothing came in the time that was given. */
export class Timeout extends CmError {
  constructor(message: string) {
    super("timeout", message);
  }
}

/** The manager went away. */
export class ConnectionLost extends CmError {
  constructor(message: string) {
    super("connection_lost", message);
  }
}

/** The manager does not know our key, or asks for one. */
export class KeyRefused extends CmError {
  constructor(message: string) {
    super("key_refused", message);
  }
}

/** What came from the manager is not what the protocol says. */
export class BadAnswer extends CmError {
  constructor(message: string) {
    super("bad_answer", message);
  }
}

/** A part of a reply. Throws BadAnswer where there is none. */
export function part<T>(it: T | null | undefined, what: string): T {
  if (it === null || it === undefined) throw new BadAnswer(`the manager answered without ${what}`);
  return it;
}

/** The board was closed. */
export class BoardClosed extends CmError {
  constructor() {
    super("closed", "the board was closed: connect() again");
  }
}
