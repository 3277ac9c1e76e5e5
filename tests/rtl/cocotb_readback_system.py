# SPDX-License-Identifier: Apache-2.0
"""The generated static part with a way back from its configuration port: read beside a stream, through its ports."""

from __future__ import annotations

import struct

import cocotb
from cocotb.triggers import with_timeout
from cocotb_static_part import CONTROL, DECOUPLE, EXPECTED, Board, check_frame, picture
from cocotbext.axi import AxiStreamBus, AxiStreamFrame, AxiStreamSink, AxiStreamSource

SYNC, NOP, STAT = 0xAA995566, 0x20000000, 0x2800E001
CLOSING = [0x30008001, 13, NOP]


@cocotb.test()
async def the_port_is_read_while_pictures_pass(dut: object) -> None:
    board = Board(dut)
    port = AxiStreamBus.from_prefix(dut, "axis_icap")
    back = AxiStreamBus.from_prefix(dut, "axis_icap_read")
    source = AxiStreamSource(port, board.clk, board.reset, reset_active_level=False)
    sink = AxiStreamSink(back, board.clk, board.reset, reset_active_level=False)
    await board.start()
    registers, model = EXPECTED["edge"]
    for offset, value in registers.items():
        await board.write(0x4001_0000 + offset, value)
    for number in range(3):
        await board.source.send(AxiStreamFrame(picture(number).tobytes()))
        await source.send(AxiStreamFrame(struct.pack("<5I", SYNC, NOP, STAT, NOP, NOP)))
        answer = await with_timeout(sink.recv(), 200, "us")
        assert struct.unpack("<I", bytes(answer.tdata)) == (0x000078FC,)
        await source.send(AxiStreamFrame(struct.pack("<3I", *CLOSING)))
        await board.wait_for(CONTROL + 0x14, 7, 5)  # DONE and EOS, no error
        check_frame(await with_timeout(board.sink.recv(), 400, "us"), model(picture(number)))
    # a read under way keeps no region cut off
    await board.write(DECOUPLE, 1)
    await source.send(AxiStreamFrame(struct.pack("<4I", SYNC, NOP, STAT, NOP)))
    await with_timeout(sink.recv(), 200, "us")
    await board.write(DECOUPLE, 0)
    assert (await board.read(DECOUPLE))[0] == 0
    await source.send(AxiStreamFrame(struct.pack("<3I", *CLOSING)))
    board.check()
