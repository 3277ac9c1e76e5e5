// SPDX-License-Identifier: Apache-2.0
import { spawn, spawnSync, type ChildProcess } from "node:child_process";
import { once } from "node:events";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";

/** The command `cm`; `$CM` says which, with its arguments between spaces. */
const CM = (process.env.CM ?? "cm").split(" ");

/** A manager on a simulated board, over ipc and, with keys, over TCP. */
export class Manager {
  readonly folder = mkdtempSync(join(tmpdir(), "cm-node-"));
  readonly runtime = join(this.folder, "run");
  readonly keys = join(this.folder, "robot.key");
  readonly stranger = join(this.folder, "stranger", "other.key");
  #process: ChildProcess | undefined;

  async start(): Promise<this> {
    this.#run("keygen", this.folder, "robot");
    this.#run("keygen", join(this.folder, "stranger"), "other");
    const child = spawn(CM[0]!, [
      ...CM.slice(1), "serve", "--sim", "--runtime-dir", this.runtime, "--state-dir", join(this.folder, "state"),
      "--listen", "tcp://127.0.0.1:0", "--keys", join(this.folder, "server.key"),
    ], { stdio: ["ignore", "ignore", "pipe"] });
    this.#process = child;
    const said: string[] = [];
    for await (const line of createInterface({ input: child.stderr! })) {
      said.push(line);
      if (line.includes("ready at")) {
        child.stderr!.resume(); // a full pipe would hold it up
        return this;
      }
    }
    throw new Error(`the manager did not start: ${said.join("\n")}`);
  }

  /** Its first TCP endpoint, as endpoints.json tells. */
  get tcp(): string {
    const told = JSON.parse(readFileSync(join(this.runtime, "endpoints.json"), "utf8")) as { tcp: { pub: string }[] };
    return told.tcp[0]!.pub;
  }

  kill(): void {
    this.#process?.kill("SIGKILL");
  }

  async stop(): Promise<void> {
    const child = this.#process;
    child?.stderr?.destroy(); // the board of a manager that was killed has it open yet
    if (child && child.exitCode === null && child.signalCode === null) {
      child.kill("SIGTERM");
      await once(child, "exit");
    }
    rmSync(this.folder, { recursive: true, force: true });
  }

  #run(...words: string[]): void {
    const done = spawnSync(CM[0]!, [...CM.slice(1), ...words], { encoding: "utf8" });
    if (done.status !== 0) throw new Error(`${CM.join(" ")} ${words.join(" ")}: ${done.stderr ?? String(done.error)}`);
  }
}
