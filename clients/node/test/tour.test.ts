// SPDX-License-Identifier: Apache-2.0
// The tour of what a client can do, over ipc and over TCP with keys.
import assert from "node:assert/strict";
import { after, before, describe, test } from "node:test";
import {
  connect, ConnectionLost, KeyRefused, loadKeys, RequestFailed, Timeout,
  type Board, type Events, type Frame, type Progress, type Values,
} from "../src/index.js";
import { Manager } from "./manager.js";

const manager = new Manager();
before(async () => { await manager.start(); });
after(async () => { await manager.stop(); });

const PATIENCE = 60; // seconds for one step, on however busy a machine
const LIMIT = { timeout: 900_000 }; // hung
const WAYS = {
  ipc: (guest = "") => connect(manager.runtime, { guest, timeout: PATIENCE }),
  curve: (guest = "") => connect(manager.tcp, { keys: manager.keys, guest, timeout: PATIENCE }),
};

for (const [way, reach] of Object.entries(WAYS)) {
  describe(`over ${way}`, LIMIT, () => {
    let board: Board;
    before(async () => { board = reach(); await board.load("camera", "default"); });
    after(() => { board.close(); });

    test("what is there is told", async () => {
      const status = await board.status();
      assert.deepEqual([status.configName, status.mode, status.fpgaBusy, status.prMode], ["camera", "default", false, "idle"]);
      const [camera] = await board.configs();
      assert.deepEqual([camera?.name, camera?.defaultMode], ["camera", "default"]);
      assert.ok(camera?.modes?.includes("edge_detection"));
      assert.ok((await board.config()).registers?.some((r) => r.name === "focus"));
    });

    test("a mode is gone to, step by step, and frames are of it", async () => {
      const steps: Progress[] = [];
      await board.load("camera", "edge_detection", { progress: (step) => steps.push(step) });
      assert.ok(steps.length > 0 && steps.every((step) => step.targetMode === "edge_detection"));
      const frame = await board.read("camera");
      assert.deepEqual([frame.shape, frame.dtype, frame.mode], [[480, 640], "uint8", "edge_detection"]);
      assert.equal(frame.data.length, 480 * 640);
      await board.setMode("default");
    });

    test("what cannot be is refused with a stable code and a sentence", async () => {
      await assert.rejects(board.setMode("edg_detection"), (error: RequestFailed) =>
        error instanceof RequestFailed && error.code === "unknown_mode" && error.message.includes("edge_detection"));
      await assert.rejects(board.registers.write({ focus: 99 }), (error: RequestFailed) => error.message.includes("focus"));
      await assert.rejects(board.registers.write({ focus: 2.5 }), RangeError);
      await assert.rejects(board.stream("camra").read(), (error: RequestFailed) => error.code === "unknown_stream");
    });

    test("a bridge asks in the name of a guest, and subscribes in its own", async () => {
      const guest = reach("web:eve");
      try {
        // the settings give no guest a role; and over TCP not even the right to be spoken for
        await assert.rejects(guest.status(), (error: RequestFailed) =>
          error instanceof RequestFailed && error.code === "forbidden" && error.message.startsWith("web:eve through "));
        assert.throws(() => guest.watch(), /handed to the bridge, not to web:eve/);
        assert.throws(() => reach("x".repeat(65)), RangeError);
      } finally {
        guest.close();
      }
    });

    test("the first frame after a write is the first that began after it", async () => {
      const stream = board.stream("camera");
      try {
        let sharpness = Infinity;
        for (const focus of [1, 6, 12]) {
          const frame = await stream.after(await board.registers.write({ focus }));
          const now = edges(frame);
          assert.ok(now < sharpness, `focus ${focus} is less sharp than the one before`);
          sharpness = now;
        }
        assert.equal((await board.registers.write({ "led.blink": "fast" })).values.led, 0x20);
        assert.deepEqual(await board.registers.read("led.blink", "focus"), { "led.blink": 2, focus: 12 });
      } finally {
        stream.close();
        await board.registers.write({ focus: 1 });
      }
    });

    test("frames come one after the other, and what is missing is counted", async () => {
      const seen: number[] = [];
      const stream = board.stream("camera", { depth: 100 });
      for await (const frame of stream) {
        seen.push(frame.sequence);
        if (seen.length === 5) break;
      }
      stream.close();
      // the camera does not wait for a reader that gets no processor time
      assert.deepEqual(seen, [...new Set(seen)].sort((a, b) => a - b));
      assert.equal(seen.at(-1)! - seen[0]! + 1, seen.length + stream.lost);
    });

    test("what is written comes back through the loop", async () => {
      await board.setMode("loopback");
      const loop = board.stream("from_pl");
      await loop.open();
      const picture = Uint8Array.from({ length: 480 * 640 }, (_, index) => index % 251);
      const back = loop.read();
      await until(async () => (await board.status()).streams.some((s) => s.name === "from_pl" && s.open));
      await board.write("to_pl", picture);
      assert.deepEqual((await back).data, picture);
      loop.close();
      await board.setMode("default");
    });

    test("memories are read and written in place", async () => {
      const values = Uint32Array.from({ length: 16 }, (_, index) => index * 0x01010101);
      await board.writeMemory("scratchpad", values, 64);
      assert.deepEqual((await board.readMemory("scratchpad", 64, 64)).data, values);
    });

    test("interrupts and writes by others are told", async () => {
      const other = reach();
      const done = board.interrupts("frame_done");
      const writes = board.registers.events();
      const stream = other.stream("camera");
      await stream.read();
      assert.ok((await done.next(PATIENCE)).count > 0);
      const values = await heard(writes, () => other.registers.write({ zoom: 2 }));
      assert.deepEqual(values, { zoom: 2 });
      await other.registers.write({ zoom: 1 });
      const came = await board.waitInterrupt("frame_done", PATIENCE); // it came before we waited
      const next = await board.waitInterrupt("frame_done", PATIENCE);
      assert.ok(next.timestampNs > came.timestampNs);
      other.close();
    });

    test("what is held is held against others, and our own calls pass", async () => {
      const other = reach();
      const lease = await board.takeLease("region:prr0");
      await board.setMode("edge_detection");
      await assert.rejects(other.setMode("default"), (error: RequestFailed) => error.code === "held_by");
      await lease.release();
      await other.setMode("default");
      other.close();
    });

    test("a time-out says how long it was, and a closed board so", async () => {
      await assert.rejects(board.stream("camera").after({ generation: 1e9 }, 0.2), Timeout);
      const other = reach();
      other.close();
      await assert.rejects(other.status(), /was closed/);
    });
  });
}

test("who has no key, or one that the board does not know, is told so", LIMIT, async () => {
  const server = loadKeys(manager.keys).serverPublic;
  for (const options of [{ keys: { ...loadKeys(manager.stranger), serverPublic: server } }, { keys: manager.stranger }, {}]) {
    const stranger = connect(manager.tcp, { ...options, timeout: PATIENCE });
    await assert.rejects(stranger.status(), KeyRefused);
    stranger.close();
  }
});

test("who waits hears at once of a manager that dies", LIMIT, async () => {
  const board = connect(manager.runtime, { timeout: PATIENCE });
  await board.setMode("loopback");
  const waiting = board.read("from_pl", 100);
  await until(async () => (await board.status()).streams.some((s) => s.name === "from_pl" && s.open));
  manager.kill();
  await assert.rejects(waiting, ConnectionLost);
  board.close();
});

/** Mean difference between neighbours in a line. */
function edges(frame: Frame): number {
  const data = frame.data as Uint8Array;
  let sum = 0;
  for (let i = 1; i < data.length; i++) sum += Math.abs(data[i]! - data[i - 1]!);
  return sum / data.length;
}

/** The values of a write, once it is told: it is done again while the manager does not know of our subscription. */
async function heard(writes: Events<Values>, write: () => Promise<Values>): Promise<Values["values"]> {
  const generations = new Set<number>();
  const end = performance.now() + PATIENCE * 1000;
  for (;;) {
    generations.add((await write()).generation);
    try {
      for (;;) {
        const event = await writes.next(1);
        if (generations.has(event.generation)) return event.values;
      }
    } catch (error) {
      if (!(error instanceof Timeout) || performance.now() > end) throw error;
    }
  }
}

async function until(condition: () => Promise<boolean>): Promise<void> {
  const end = performance.now() + PATIENCE * 1000;
  while (!(await condition())) {
    assert.ok(performance.now() < end, "the condition did not come true");
    await new Promise((resolve) => setTimeout(resolve, 5));
  }
}
