// SPDX-License-Identifier: Apache-2.0
import { existsSync, readFileSync } from "node:fs";
import { join, resolve } from "node:path";

/** The three ZeroMQ endpoints of a manager. */
export interface Endpoints {
  readonly pub: string;
  readonly sub: string;
  readonly req: string;
}

/** CURVE keys of a client, and the manager's public key (Z85, 40 characters each). */
export interface Keys {
  readonly serverPublic: string;
  readonly public: string;
  readonly secret: string;
}

const FIRST_PORT = 5560;

/** `tcp://host[:port]`, `ipc://folder` or a runtime folder; nothing: that of this machine's manager. */
export function endpoints(address?: string): Endpoints {
  if (address?.startsWith("tcp://")) return overTcp(address);
  const folder = resolve(address?.replace(/^ipc:\/\//, "") ?? runtimeFolder());
  const at = (name: string) => `ipc://${join(folder, name)}`;
  if (!existsSync(join(folder, "req"))) {
    throw new Error(`no configuration manager serves ${folder}: start one ('cm serve'), or name its runtime folder`);
  }
  return { pub: at("pub"), sub: at("sub"), req: at("req") };
}

function overTcp(address: string): Endpoints {
  const found = /^tcp:\/\/(\[[^\]]+\]|[^:]+)(?::(\d+))?$/.exec(address);
  const port = found?.[2] ? Number(found[2]) : FIRST_PORT;
  if (!found || port > 65533) throw new Error(`${address} is not tcp://host[:port]; three ports in a row are used`);
  const at = (offset: number) => `tcp://${found[1]}:${port + offset}`;
  return { pub: at(0), sub: at(1), req: at(2) };
}

/** As docs/cli.md has it. */
function runtimeFolder(): string {
  const { CM_RUNTIME_DIR: chosen, XDG_RUNTIME_DIR: user } = process.env;
  if (chosen) return chosen;
  if (existsSync("/run/cm/req") || process.getuid?.() === 0 || !user) return "/run/cm";
  return join(user, "cm");
}

/** The file that `cm keygen` wrote for a client: lines `name: value`. */
export function loadKeys(path: string): Keys {
  const pairs = new Map<string, string>();
  for (const line of readFileSync(path, "ascii").split("\n")) {
    const colon = line.indexOf(":");
    if (colon > 0 && !line.startsWith("#")) pairs.set(line.slice(0, colon).trim(), line.slice(colon + 1).trim());
  }
  const key = (name: string): string => {
    const value = pairs.get(name);
    if (!value) throw new Error(`${path}: no ${name} key; a client's file has server-public, public, secret`);
    return value;
  };
  return { serverPublic: key("server-public"), public: key("public"), secret: key("secret") };
}
