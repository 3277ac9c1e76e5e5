# SPDX-License-Identifier: Apache-2.0
"""Data too long for one message is sent in parts first. Each flow returns the call that follows."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cm.client.core import calls
from cm.client.core.calls import Call
from cm.client.core.flow_effects import Flow
from cm.client.errors import RequestFailed, RequestInvalid
from cm.frozen import replace
from cm.wire.messages import requests as rq
from cm.wire.messages.status import PIXEL_FORMAT, ConfigInfo, FrameInfo

WHOLE = 4 << 20  # most bytes that are sent in the message itself
PART = 1 << 20


def provision(schema: Path, files: Sequence[Path], lease: str) -> Flow[Call[ConfigInfo]]:
    """Send the files of a configuration, if they are long, one after the other."""
    call = calls.provision(schema, tuple(files), lease)
    request = call.request
    if not isinstance(request, rq.Provision) or sum(len(file.data) for file in request.files) <= WHOLE:
        return call
    sent = []
    for file in request.files:
        name = yield from upload(file.data)
        sent.append(file.uploaded(name) if name else file)
    return replace(call, request=replace(request, files=tuple(sent)))


def write_data(stream: str, data: Any, lease: str) -> Flow[Call[FrameInfo]]:
    """Send the bytes of a frame, if they are many."""
    call = calls.write_data(stream, data, lease)
    request = call.request
    if not isinstance(request, rq.WriteData) or len(request.data) <= WHOLE:
        return call
    name = yield from upload(request.data)
    return replace(call, request=replace(request, data=b"", upload=name)) if name else call


def recoded(refused: RequestFailed, stream: str, data: Any, lease: str) -> Flow[Call[FrameInfo]]:
    """A picture in RGB again, as the stream's format has it. Raises `refused` if that was not what it was about."""
    if refused.code != PIXEL_FORMAT:
        raise refused
    from cm.client.pixel_formats import from_rgb  # imported here: it needs numpy

    status = yield calls.describe_stream(stream)
    return (yield from write_data(stream, from_rgb(data, status.format).reshape(-1), lease))


def discarding(call: Call[Any]) -> Flow[None]:
    """Have the manager forget what was sent for a call that it has refused: it would keep it for another try."""
    request = call.request
    if isinstance(request, rq.Provision):
        names = [file.upload for file in request.files]
    else:
        names = [request.upload] if isinstance(request, rq.WriteData) else []
    for name in filter(None, names):
        yield calls.upload(rq.Upload(name, discard=True))


def upload(data: bytes | memoryview) -> Flow[str]:
    """Send bytes in parts; returns the upload's name, or "" if the manager is too old to support parts."""
    name, view = os.urandom(8).hex(), memoryview(data)
    for start in range(0, max(len(view), 1), PART):
        try:
            yield calls.upload(rq.Upload(name, len(view), offset=start, data=view[start : start + PART]))
        except RequestInvalid as error:
            if start or "unknown topic" not in str(error):
                raise
            return ""
    return name
