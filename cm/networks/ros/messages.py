# SPDX-License-Identifier: Apache-2.0
"""Records of a bridge as ROS messages: plain values, field by field."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from cm.networks.bridge.records import ConfigRecord, FrameRecord, StreamFormat
from cm.networks.ros.transport import Values
from cm.wire.messages.json_values import plain
from cm.wire.messages.status import Irq, PlanInfo, RegValues, Status, place
from cm.wire.records import Gap

_OK, _WARN, _ERROR, _STALE = b"\0", b"\1", b"\2", b"\3"


def time(stamp_ns: int) -> dict[str, int]:
    """builtin_interfaces/Time."""
    sec, nanosec = divmod(stamp_ns, 10**9)
    return {"sec": sec, "nanosec": nanosec}


def header(stamp_ns: int, frame_id: str = "") -> dict[str, Any]:
    """std_msgs/Header."""
    return {"stamp": time(stamp_ns), "frame_id": frame_id}


def status(s: Status, stamp_ns: int) -> Values:
    """cm_interfaces/Status."""
    p = s.progress
    return {
        "header": header(stamp_ns),
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
        "modes": [{"name": m.name, "modules": m.modules, "registers": m.registers} for m in record.config.modes],
        "interrupts": [interrupt.name for interrupt in record.config.interrupts],
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


def interrupt(irq: Irq, stamp_ns: int) -> Values:
    """cm_interfaces/Interrupt."""
    return {"header": header(stamp_ns), "name": irq.name, "count": irq.count}


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
        "shape": frame.data.shape,
        "dtype": frame.data.dtype.name,
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
    return {"steps": [asdict(step) for step in info.steps], "bytes": info.bytes, "seconds": info.seconds}


def diagnostics(node: str, now: Status | None, problem: str, stamp_ns: int) -> Values:
    """diagnostic_msgs/DiagnosticArray: the board, each region that was checked, each stream that runs.

    `problem`: why there is no manager.
    """
    rows = list(_diagnosed(now)) if now is not None and not problem else []
    rows = rows or [(_STALE, "board", problem or "nothing is known yet", {})]
    board = now.board if now is not None else ""
    told = [_row(level, f"{node}: {name}", text, board, values) for level, name, text, values in rows]
    return {"header": header(stamp_ns), "status": told}


def gap(board: str, missing: Gap) -> Values:
    """diagnostic_msgs/DiagnosticArray: what a record does not have."""
    row = _row(_ERROR, "cm record: gap", missing.text, board, plain(missing))
    return {"header": header(missing.until_ns), "status": [row]}


def _diagnosed(now: Status) -> Iterator[tuple[bytes, str, str, dict[str, Any]]]:
    """Level, name, text and values of each row."""
    level, text = _OK, place(now.config_name, now.mode) if now.config_name else "nothing is loaded"
    if now.last_error is not None:
        level, text = (_ERROR if now.pr_mode.value == "error" else _WARN), now.last_error.message
    values = {"config_name": now.config_name, "mode": now.mode, "pr_mode": now.pr_mode.value, "version": now.version}
    values |= {f"region {r.name}": f"{r.module or '-'} ({r.state})" for r in now.regions}
    values |= {f"{s.device} {s.name} ({s.quantity})": f"{s.value:g}" for s in now.sensors}
    yield level, "board", text, values
    for r in now.regions:
        if (health := r.health) is not None:
            found = f"{health.upsets} upsets found, {health.repairs} repairs"
            level, text = (_WARN, f"{health.wrong_bits} bits are wrong") if health.wrong_bits else (_OK, found)
            yield level, f"region {r.name}", text, asdict(health)
    for s in now.streams:
        if s.open:
            level, text = (_WARN, s.last_error.message) if s.last_error else (_OK, f"{s.rate:.1f} frames per second")
            said = {"frames": s.frames, "dropped": s.dropped, "errors": s.errors, "rate": f"{s.rate:.2f}"}
            yield level, f"stream {s.name}", text, {**said, "latency_us": f"{s.latency_us:.1f}"}


def _row(level: bytes, name: str, text: str, board: str, values: dict[str, Any]) -> Values:
    pairs = [{"key": key, "value": str(value)} for key, value in values.items()]
    return {"level": level[0], "name": name, "message": text, "hardware_id": board, "values": pairs}
