// SPDX-License-Identifier: Apache-2.0
import { BadAnswer } from "./errors.js";
import type { cm } from "./proto/cm.js";
import { count } from "./numbers.js";

/** Elements of a frame in the machine's memory. */
export type Elements =
  | Uint8Array | Int8Array | Uint16Array | Int16Array | Uint32Array | Int32Array
  | BigUint64Array | BigInt64Array | Float32Array | Float64Array;

const TYPES = new Map<string, new (buffer: ArrayBuffer) => Elements>(Object.entries({
  bool: Uint8Array, uint8: Uint8Array, int8: Int8Array, uint16: Uint16Array, int16: Int16Array,
  uint32: Uint32Array, int32: Int32Array, uint64: BigUint64Array, int64: BigInt64Array,
  float32: Float32Array, float64: Float64Array,
}));

/** A frame of a stream, or a part of a memory: a copy of one's own. */
export interface Frame {
  readonly stream: string;
  /** Number in the stream; a gap is a loss. */
  readonly sequence: number;
  /** CLOCK_MONOTONIC of the board when the transfer had ended, in nanoseconds. */
  readonly timestampNs: number;
  readonly shape: readonly number[];
  /** numpy's name of an element's type; data of types that JavaScript has none for are bytes. */
  readonly dtype: string;
  readonly mode: string;
  /** Of the registers, when this frame began; 0: not known. */
  readonly generation: number;
  readonly data: Elements;
}

/** A description and the bytes beside it. Throws BadAnswer where they disagree. */
export function frameOf(info: cm.IFrame, payload: Uint8Array): Frame {
  const dtype = info.dtype ?? "uint8";
  if (count(info.length) !== payload.byteLength) {
    throw new BadAnswer(`frame ${count(info.sequence)} of ${info.stream} has not the ${count(info.length)} bytes that it claims`);
  }
  const bytes = payload.buffer.slice(payload.byteOffset, payload.byteOffset + payload.byteLength) as ArrayBuffer;
  return {
    stream: info.stream ?? "",
    sequence: count(info.sequence),
    timestampNs: count(info.timestampNs),
    shape: info.shape ?? [],
    dtype,
    mode: info.mode ?? "",
    generation: count(info.generation),
    data: elements(dtype, bytes),
  };
}

function elements(dtype: string, bytes: ArrayBuffer): Elements {
  try {
    return new (TYPES.get(dtype) ?? Uint8Array)(bytes);
  } catch {
    throw new BadAnswer(`${bytes.byteLength} bytes are no elements of ${dtype}`);
  }
}
