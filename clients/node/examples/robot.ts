// SPDX-License-Identifier: Apache-2.0
// A robot's loop without a browser or a screen: observe, decide, act. It focuses its camera by the picture alone,
// then looks for edges, and gives the board back.
//
//   node dist/examples/robot.js [tcp://board robot.key]
import { connect, type Board, type Frame } from "../src/index.js";

const [address, keys] = process.argv.slice(2);
const board = connect(address, keys ? { keys } : {});

/** Mean difference between neighbours in a line: the sharper, the larger. */
function sharpness(frame: Frame): number {
  const data = frame.data as Uint8Array;
  let sum = 0;
  for (let i = 1; i < data.length; i++) sum += Math.abs(data[i]! - data[i - 1]!);
  return sum / data.length;
}

/** Observe after each act: no frame from before the write is taken for one of after it. */
async function focus(board: Board): Promise<number> {
  const camera = board.stream("camera");
  let best = { focus: 0, sharpness: -1 };
  for (const value of [0, 1, 2, 4, 8]) {
    const frame = await camera.after(await board.registers.write({ focus: value }));
    const now = sharpness(frame);
    console.log(`focus ${value}: sharpness ${now.toFixed(2)} in frame ${frame.sequence}`);
    if (now > best.sharpness) best = { focus: value, sharpness: now };
  }
  camera.close();
  return best.focus;
}

const lease = await board.takeLease("region:prr0", { holder: "robot" });
try {
  await board.load("camera", "default");
  const best = await focus(board);
  await board.registers.write({ focus: best });
  const seconds = await board.setMode("edge_detection");
  console.log(`focus ${best} is the sharpest; looking for edges after ${(seconds * 1000).toFixed(1)} ms`);
  const frame = await board.read("camera");
  const bright = (frame.data as Uint8Array).reduce((sum, value) => sum + (value > 96 ? 1 : 0), 0);
  console.log(`${((100 * bright) / frame.data.length).toFixed(1)} % of frame ${frame.sequence} are edges`);
} finally {
  await lease.release();
  board.close();
}
