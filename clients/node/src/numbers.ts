// SPDX-License-Identifier: Apache-2.0
import Long from "long";

/** An integer of the wire: a bigint only where a number would lose digits (beyond 2^53). */
export type Int = number | bigint;

/** A 64-bit integer as it came. */
export function int(value: Long | number | null | undefined): Int {
  if (value === null || value === undefined) return 0;
  if (typeof value === "number") return value;
  const whole = BigInt(value.toString());
  return whole >= BigInt(Number.MIN_SAFE_INTEGER) && whole <= BigInt(Number.MAX_SAFE_INTEGER) ? Number(whole) : whole;
}

/** A count, which stays within 2^53. */
export function count(value: Long | number | null | undefined): number {
  return Number(int(value));
}

/** An unsigned integer as it goes. Throws RangeError for what would be turned into another. */
export function unsigned(value: Int, what: string): Long {
  const whole = typeof value === "bigint" || Number.isSafeInteger(value);
  if (!whole || value < 0 || BigInt(value) >= 1n << 64n) {
    throw new RangeError(`${what}: ${String(value)} is not an unsigned integer of 64 bits (beyond 2^53 as a bigint)`);
  }
  return Long.fromString(String(value), true);
}
