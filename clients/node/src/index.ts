// SPDX-License-Identifier: Apache-2.0
export { endpoints, loadKeys, type Endpoints, type Keys } from "./address.js";
export { Board, connect, type ConnectOptions, type Interrupt, type LoadOptions } from "./board.js";
export { BadAnswer, BoardClosed, CmError, ConnectionLost, KeyRefused, RequestFailed, Timeout } from "./errors.js";
export { Events } from "./events.js";
export type { Elements, Frame } from "./frame.js";
export { Lease } from "./lease.js";
export type { Answer } from "./link.js";
export type { Int } from "./numbers.js";
export { cm } from "./proto/cm.js";
export { Registers, type Values } from "./registers.js";
export type { Progress, Status } from "./status.js";
export { FrameStream, type StreamOptions } from "./stream.js";
