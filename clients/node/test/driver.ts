// SPDX-License-Identifier: Apache-2.0
// What `cm conformance` asks of this client, in lines of JSON (docs/conformance.md).
import { createInterface } from "node:readline";
import { CmError, connect, type Board, type Frame, type Int } from "../src/index.js";

type Action = Record<string, any>;
type Result = Record<string, unknown>;

let reach: (guest?: string) => Board; // the manager of the case

const plain = (value: Int) => (typeof value === "bigint" ? String(value) : value);
const all = (values: Readonly<Record<string, Int>>) =>
  Object.fromEntries(Object.entries(values).map(([name, value]) => [name, plain(value)]));
const described = (frame: Frame) => ({
  sequence: frame.sequence, shape: frame.shape, dtype: frame.dtype, data: [...(frame.data as Uint16Array)],
});

const ACTIONS: Record<string, (board: Board, action: Action) => Promise<Result>> = {
  async status(board) {
    const status = await board.status();
    return { config: status.configName, mode: status.mode, busy: status.fpgaBusy };
  },
  read: async (board, { names }) => ({ values: all(await board.registers.read(...(names as string[]))) }),
  async write(board, { registers }) {
    const values = Object.entries(registers as Record<string, number | string>)
      .map(([name, value]) => [name, typeof value === "string" && /^\d+$/.test(value) ? BigInt(value) : value] as const);
    const written = await board.registers.write(Object.fromEntries(values));
    return { values: all(written.values), generation: written.generation };
  },
  async write_masked(board, { name, value, mask }) {
    const written = await board.registers.writeMasked(name as string, value as number, mask as number);
    return { values: all(written.values), generation: written.generation };
  },
  mode: async (board, { mode }) => ({ seconds: await board.setMode(mode as string) }),
  async statuses(board, { count }) {
    const modes: string[] = [];
    const statuses = board.watch();
    while (modes.length < count) modes.push((await statuses.next(board.timeout)).mode);
    return { modes };
  },
  frame: async (board, { stream }) => described(await board.read(stream as string)),
  async frames(board, { stream, count }) {
    const sequences: number[] = [];
    const frames = board.stream(stream as string, { depth: 100, timeout: board.timeout });
    while (sequences.length < count) sequences.push((await frames.read()).sequence);
    return { sequences, lost: frames.lost };
  },
  after: async (board, { stream, generation }) =>
    described(await board.stream(stream as string, { depth: 100, timeout: board.timeout }).after({ generation: generation as number })),
  async irqs(board, { name, count }) {
    const counts: number[] = [];
    const irqs = board.interrupts(name as string);
    while (counts.length < count) counts.push((await irqs.next(board.timeout)).count);
    return { counts };
  },
  lease: async (board, { scope }) => ({ id: (await board.takeLease(scope as string)).id }),
  async send(board, { stream, data }) {
    await board.write(stream as string, Uint8Array.from(data as number[]));
    return {};
  },
  async as_guest(_, { guest, action }) {
    const board = reach(guest as string);
    try {
      return await done(board, action as Action);
    } finally {
      board.close();
    }
  },
  together: async (board, { actions }) => ({ results: await Promise.all((actions as Action[]).map((a) => done(board, a))) }),
};

async function done(board: Board, action: Action): Promise<Result> {
  try {
    return (await ACTIONS[action.do as string]?.(board, action)) ?? { unsupported: true };
  } catch (error) {
    return { error: error instanceof CmError ? error.code : String(error) };
  }
}

for await (const line of createInterface({ input: process.stdin })) {
  const asked = JSON.parse(line) as { connect: { folder?: string; endpoint?: string; keys?: string }; timeout: number; do: Action[] };
  const { folder, endpoint, keys } = asked.connect;
  reach = (guest = "") => connect(folder ?? endpoint, { ...(keys ? { keys } : {}), timeout: asked.timeout, guest });
  const board = reach();
  const results: Result[] = [];
  for (const action of asked.do) results.push(await done(board, action));
  board.close();
  console.log(JSON.stringify({ results }));
}
