# SPDX-License-Identifier: Apache-2.0
"""Coverage-guided fuzzing of everything that reads a bitstream (needs atheris).

    pip install atheris
    python tests/fuzz/fuzz_bitstream.py -max_total_time=60 CORPUS_DIR

Whatever the bytes: they are inspected, or refused with a `BitstreamError`; the port takes them in
any pieces; what can be converted comes back byte for byte.
"""

from __future__ import annotations

import sys
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["cm.bitstream"]):
    from cm.bitstream import (
        BitstreamError,
        Container,
        FrameAddress,
        FrameRun,
        assemble,
        convert,
        device_by_name,
        inspect,
        open_image,
    )

with atheris.instrument_imports(include=["cm.sim.hardware"]):
    from cm.sim.hardware.packets import ConfigPort

_DEVICE = device_by_name("xc7z020")


def seeds() -> list[bytes]:
    """Valid files of each form, from which the fuzzer starts."""
    bit = assemble("xc7z020", [FrameRun(FrameAddress(0, 0, 26), bytes(404))])
    header = bytearray(0x8C0)
    header[0x24:0x28] = b"XNLX"
    swapped = convert(bit, Container.BIN_SWAPPED)
    return [bit, swapped, convert(bit, Container.BIN_STRAIGHT), bytes(header) + swapped]


def one(data: bytes) -> None:
    """Feed one input to all that reads bitstreams."""
    assert _DEVICE is not None
    port = ConfigPort(_DEVICE, swapped=bool(len(data) & 1))
    half = len(data) // 2
    port.feed(data[:half])
    port.feed(data[half:])
    try:
        image = open_image(data)
        inspect(data).to_json()
        other = convert(data, Container.BIN_STRAIGHT)
    except BitstreamError:
        return
    if image.container is Container.BIT:
        assert convert(other, Container.BIT, image.header) == data


def main() -> None:
    corpus = [Path(argument) for argument in sys.argv[1:] if not argument.startswith("-")]
    for folder in corpus[:1]:
        folder.mkdir(parents=True, exist_ok=True)
        for index, seed in enumerate(seeds()):
            (folder / f"seed{index}").write_bytes(seed)
    atheris.Setup(sys.argv, one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
