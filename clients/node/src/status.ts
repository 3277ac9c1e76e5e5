// SPDX-License-Identifier: Apache-2.0
import { cm } from "./proto/cm.js";
import { count } from "./numbers.js";

/** Where a running change is; `fraction` is 0 to 1 over the whole change. */
export interface Progress {
  readonly change: number;
  readonly targetConfig: string;
  readonly targetMode: string;
  readonly step: string;
  readonly subject: string;
  readonly fraction: number;
}

/** What the manager knows of the board: the content of `cm_status`, whole in `raw`. */
export interface Status {
  readonly configName: string;
  readonly mode: string;
  readonly fpgaBusy: boolean;
  readonly prMode: "idle" | "partial" | "full" | "error";
  readonly progress: Progress | undefined;
  readonly lastError: { readonly code: string; readonly message: string } | undefined;
  readonly sequence: number;
  readonly lastChange: number;
  readonly generation: number;
  readonly board: string;
  readonly regions: readonly { readonly name: string; readonly module: string; readonly state: string }[];
  readonly streams: readonly { readonly name: string; readonly direction: string; readonly open: boolean;
    readonly shape: readonly number[]; readonly dtype: string; readonly frames: number; readonly errors: number }[];
  readonly raw: cm.IStatus;
}

const PR_MODES = ["idle", "partial", "full", "error"] as const;

export function statusOf(raw: cm.IStatus): Status {
  return {
    configName: raw.configName ?? "",
    mode: raw.mode ?? "",
    fpgaBusy: raw.fpgaBusy ?? false,
    prMode: PR_MODES[raw.prMode ?? 0] ?? "error",
    progress: raw.progress ? progressOf(raw.progress) : undefined,
    lastError: raw.lastError ? { code: raw.lastError.code ?? "", message: raw.lastError.message ?? "" } : undefined,
    sequence: count(raw.sequence),
    lastChange: count(raw.lastChange),
    generation: count(raw.generation),
    board: raw.board ?? "",
    regions: (raw.regions ?? []).map((r) => ({ name: r.name ?? "", module: r.module ?? "", state: r.state ?? "" })),
    streams: (raw.streams ?? []).map((s) => ({
      name: s.name ?? "", direction: s.direction ?? "", open: s.open ?? false, shape: s.shape ?? [],
      dtype: s.dtype ?? "", frames: count(s.frames), errors: count(s.errors),
    })),
    raw,
  };
}

function progressOf(raw: cm.IProgress): Progress {
  return {
    change: count(raw.change), targetConfig: raw.targetConfig ?? "", targetMode: raw.targetMode ?? "",
    step: raw.step ?? "", subject: raw.subject ?? "", fraction: raw.fraction ?? 0,
  };
}
