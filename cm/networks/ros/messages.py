# SPDX-License-Identifier: Apache-2.0
"""Records of a bridge as ROS messages: plain values, field by field."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from cm.networks.bridge.records import (
    ConfigRecord,
    FrameRecord,
    Identity,
    InterruptRecord,
    RegistersRecord,
    StatusRecord,
    StreamFormat,
)
from cm.networks.ros.transport import Values
from cm.wire.messages.status import PlanInfo, RegionHealth, RegValues, Status, StreamStatus
from cm.wire.records import Gap

_BILLION = 10**9
_OK, _WARN, _ERROR, _STALE = b"\0", b"\1", b"\2", b"\3"


def time(stamp_ns: int) -> dict[str, int]:
    """builtin_interfaces/Time."""
    sec, nanosec = divmod(stamp_ns, _BILLION)
    return {"sec": sec, "nanosec": nanosec}


def header(stamp_ns: int, frame_id: str = "") -> dict[str, Any]:
    """std_msgs/Header."""
    return {"stamp": time(stamp_ns), "frame_id": frame_id}


def status(record: StatusRecord) -> Values:
    """cm_interfaces/Status."""
    s, p = record.status, record.status.progress
    return {
        "header": header(record.stamp_ns),
        "board": s.board,
        "config_name": s.config_name,
        "mode": s.mode,
        "fpga_busy": s.fpga_busy,
        "pr_mode": s.pr_mode.value,
        "sequence": s.sequence,
        "target_config": p.target_config if p else "",
        "target_mode": p.target_mode if p else "",
        "step": p.step if p else "",
        "subject": p.subject if p else "",
        "fraction": p.fraction if p else 0.0,
        "last_change": s.last_change,
        "last_change_seconds": s.last_change_seconds,
        "error_code": s.last_error.code if s.last_error else "",
        "error_message": s.last_error.message if s.last_error else "",
        "regions": [{"name": r.name, "module": r.module or "", "state": r.state} for r in s.regions],
        "configs": s.configs,
    }


def configuration(record: ConfigRecord) -> Values:
    """cm_interfaces/Configuration."""
    return {
        "header": header(record.stamp_ns),
        "name": record.config.name,
        "mode": record.config.mode,
        "modes": [{"name": m.name, "modules": m.modules, "registers": m.registers} for m in record.modes],
        "interrupts": [interrupt.name for interrupt in record.interrupts],
        "readable_streams": [stream.name for stream in record.streams if not stream.writes],
        "writable_streams": [stream.name for stream in record.streams if stream.writes],
    }


def bank(values: RegValues, stamp_ns: int) -> Values:
    """cm_interfaces/RegisterBank."""
    return {
        "header": header(stamp_ns),
        "config_name": values.config_name,
        "mode": values.mode,
        "generation": values.generation,
        "registers": [
            {"name": v.name, "value": v.value, "fields": [{"name": n, "value": x} for n, x in v.fields]}
            for v in values.values
        ],
    }


def registers(record: RegistersRecord) -> Values:
    """cm_interfaces/RegisterBank of what was written."""
    return bank(record.registers, record.stamp_ns)


def interrupt(record: InterruptRecord) -> Values:
    """cm_interfaces/Interrupt."""
    return {"header": header(record.stamp_ns), "name": record.irq.name, "count": record.irq.count}


def image_head(frame: FrameRecord) -> Values:
    """sensor_msgs/Image without its data."""
    return {
        "header": header(frame.stamp_ns, frame.frame_id),
        "height": frame.height,
        "width": frame.width,
        "encoding": frame.encoding,
        "is_bigendian": 0,
        "step": frame.step,
    }


def data_head(frame: FrameRecord) -> Values:
    """cm_interfaces/Data without its data."""
    return {
        "header": header(frame.stamp_ns, frame.frame_id),
        "stream": frame.stream,
        "sequence": frame.sequence,
        "shape": frame.shape,
        "dtype": frame.dtype,
    }


def camera_info(stream: StreamFormat, frame: FrameRecord) -> Values:
    """sensor_msgs/CameraInfo; without a calibration K is zero, as ROS has it for a camera that is not calibrated."""
    values: dict[str, Any] = {
        "header": header(frame.stamp_ns, frame.frame_id),
        "height": frame.height,
        "width": frame.width,
        "k": (0.0,) * 9,
        "r": (0.0,) * 9,
        "p": (0.0,) * 12,
    }
    info = stream.camera_info
    if info is not None:
        values.update(height=info.height, width=info.width, distortion_model=info.distortion_model)
        values.update(d=info.d, k=info.k, r=info.r, p=info.projection)
    return values


def plan(info: PlanInfo) -> dict[str, Any]:
    """The reply of cm_interfaces/Plan, without `success`."""
    steps = [
        {"kind": s.kind, "subject": s.subject, "text": s.text, "bytes": s.bytes, "seconds": s.seconds}
        for s in info.steps
    ]
    return {"steps": steps, "bytes": info.bytes, "seconds": info.seconds}


def diagnostics(node: str, board: Identity, now: Status | None, problem: str, stamp_ns: int) -> Values:
    """diagnostic_msgs/DiagnosticArray: the board, each region that was checked, each stream that runs.

    `problem`: why there is no manager.
    """
    rows = [_diagnosed_board(node, board, now, problem)]
    if now is not None and not problem:
        rows += [_diagnosed_region(node, board, r.name, r.health) for r in now.regions if r.health is not None]
        rows += [_diagnosed_stream(node, board, stream) for stream in now.streams if stream.open]
    return {"header": header(stamp_ns), "status": rows}


def gap(board: str, missing: Gap) -> Values:
    """diagnostic_msgs/DiagnosticArray: what a record does not have."""
    row = _row(_ERROR, "cm record: gap", missing.text, Identity(board), missing._asdict())
    return {"header": header(missing.until_ns), "status": [row]}


def _diagnosed_board(node: str, board: Identity, now: Status | None, problem: str) -> Values:
    if problem or now is None:
        return _row(_STALE, f"{node}: board", problem or "nothing is known yet", board, {})
    level, text = _OK, f"{now.config_name}/{now.mode}" if now.config_name else "nothing is loaded"
    if now.last_error is not None:
        level, text = (_ERROR if now.pr_mode.value == "error" else _WARN), now.last_error.message
    values = {"config_name": now.config_name, "mode": now.mode, "pr_mode": now.pr_mode.value, "version": now.version}
    values |= {f"region {r.name}": f"{r.module or '-'} ({r.state})" for r in now.regions}
    values |= {f"{s.device} {s.name} ({s.quantity})": f"{s.value:g}" for s in now.sensors}
    return _row(level, f"{node}: board", text, board, values)


def _diagnosed_region(node: str, board: Identity, region: str, health: RegionHealth) -> Values:
    level, text = _OK, f"{health.upsets} upsets found, {health.repairs} repairs"
    if health.wrong_bits:
        level, text = _WARN, f"{health.wrong_bits} bits are wrong"
    return _row(level, f"{node}: region {region}", text, board, asdict(health))


def _diagnosed_stream(node: str, board: Identity, stream: StreamStatus) -> Values:
    level, text = _OK, f"{stream.rate:.1f} frames per second"
    if stream.last_error is not None:
        level, text = _WARN, stream.last_error.message
    values = {"frames": stream.frames, "dropped": stream.dropped, "errors": stream.errors, "rate": f"{stream.rate:.2f}"}
    values |= {"latency_us": f"{stream.latency_us:.1f}"}
    return _row(level, f"{node}: stream {stream.name}", text, board, values)


def _row(level: bytes, name: str, text: str, board: Identity, values: dict[str, Any]) -> Values:
    pairs = [{"key": key, "value": str(value)} for key, value in values.items()]
    return {"level": level[0], "name": name, "message": text, "hardware_id": board.name, "values": pairs}
