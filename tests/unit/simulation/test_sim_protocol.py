# SPDX-License-Identifier: Apache-2.0
"""The simulator's structures are those of the uapi headers, as a C compiler lays them out."""

from __future__ import annotations

import errno
import shutil
import struct
import subprocess
from pathlib import Path

import pytest

from cm.simulation.software.errors import NodeError
from cm.simulation.software.transport import protocol as p

UAPI = Path(__file__).resolve().parents[3] / "kmod" / "uapi"

SIZES = {
    "struct cm_node_request": p.REQUEST,
    "struct cm_node_reply": p.REPLY,
    "struct cm_node_reg": p.REG,
    "struct cm_node_mirror": p.MIRROR,
    "struct cm_node_block": p.BLOCK,
    "struct cm_buffer_alloc": p.BUFFER_ALLOC,
    "struct cm_buffer_import": p.BUFFER_IMPORT,
    "struct cm_buffer_free": p.BUFFER_FREE,
    "struct cm_dma_info": p.DMA_INFO,
    "struct cm_dma_submit": p.DMA_SUBMIT,
    "struct cm_dma_submit_video": p.DMA_SUBMIT_VIDEO,
    "struct cm_dma_cancel": p.DMA_CANCEL,
    "struct cm_dma_completion": p.DMA_COMPLETION,
    "struct cm_icap_info": p.ICAP_INFO,
    "struct cm_icap_load": p.ICAP_LOAD,
    "struct cm_icap_read": p.ICAP_READ,
    "struct cm_icap_status": p.ICAP_STATUS,
    "struct cm_icap_completion": p.ICAP_COMPLETION,
    "struct gpiochip_info": p.GPIO_CHIP_INFO,
    "struct gpio_v2_line_info": p.GPIO_LINE_INFO,
    "struct gpio_v2_line_request": p.GPIO_LINE_REQUEST,
    "struct gpio_v2_line_config": p.GPIO_LINE_CONFIG,
    "struct gpio_v2_line_values": p.GPIO_LINE_VALUES,
}
FIELDS = {
    "struct cm_node_reg": "map width offset value",
    "struct cm_node_mirror": "map fd size",
    "struct cm_node_block": "map length offset",
    "struct cm_buffer_alloc": "size flags length handle fd coherent reserved address",
    "struct cm_buffer_import": "size flags fd handle length",
    "struct cm_dma_info": "size flags direction type caps queue_depth max_length alignment frame_length name",
    "struct cm_dma_submit": "size flags handle reserved offset length period cookie",
    "struct cm_dma_submit_video": "size flags handle lines offset line_bytes stride cookie",
    "struct cm_dma_completion": "cookie length timestamp_ns sequence status flags",
    "struct cm_icap_info": "size flags word_bits clock_hz max_length idcode caps",
    "struct cm_icap_load": "size flags handle reserved offset length cookie",
    "struct cm_icap_read": "size flags handle reserved request_offset request_length reply_offset reply_length"
    " closing_offset closing_length cookie",
    "struct cm_icap_status": "size flags state errors bytes_done bytes_total loads",
    "struct cm_icap_completion": "cookie length started_ns finished_ns status errors",
}
NUMBERS = {
    "GPIO_GET_CHIPINFO_IOCTL": p.GPIO_CHIP_INFO_IOCTL,
    "GPIO_V2_GET_LINEINFO_IOCTL": p.GPIO_GET_LINE_INFO_IOCTL,
    "GPIO_V2_GET_LINE_IOCTL": p.GPIO_GET_LINE_IOCTL,
    "GPIO_V2_LINE_SET_CONFIG_IOCTL": p.GPIO_SET_CONFIG_IOCTL,
    "GPIO_V2_LINE_GET_VALUES_IOCTL": p.GPIO_GET_VALUES_IOCTL,
    "GPIO_V2_LINE_FLAG_OUTPUT": p.GPIO_FLAG_OUTPUT,
    "GPIO_V2_LINE_ATTR_ID_OUTPUT_VALUES": p.GPIO_ATTR_OUTPUT_VALUES,
    "CM_NODE_PAYLOAD_MAX": p.PAYLOAD_MAX,
    "CM_NODE_OP_REG_READ": p.OP_REG_READ,
    "CM_NODE_OP_REG_WRITE": p.OP_REG_WRITE,
    "CM_NODE_OP_MIRROR": p.OP_MIRROR,
    "CM_NODE_OFFERS_MIRROR": p.OFFERS_MIRROR,
    "CM_NODE_OP_BLOCK_READ": p.OP_BLOCK_READ,
    "CM_NODE_OP_BLOCK_WRITE": p.OP_BLOCK_WRITE,
    "CM_NODE_OFFERS_BLOCKS": p.OFFERS_BLOCKS,
    "CM_NODE_BLOCK_MAX": p.BLOCK_MAX,
    "CM_NODE_OP_ATTR_READ": p.OP_ATTR_READ,
    "CM_NODE_OP_ATTR_WRITE": p.OP_ATTR_WRITE,
    "CM_NODE_OP_MKDIR": p.OP_MKDIR,
    "CM_NODE_OP_RMDIR": p.OP_RMDIR,
    "CM_DMA_SUBMIT_CYCLIC": p.SUBMIT_CYCLIC,
    "CM_DMA_COMPLETION_OVERRUN": p.COMPLETION_OVERRUN,
    "CM_DMA_CAP_RESIDUE": p.CAP_RESIDUE,
    "CM_ICAP_ERR_NOSYNC": p.ERR_NOSYNC,
    "CM_ICAP_ERR_PORT": p.ERR_PORT,
    "CM_ICAP_ERR_TIMEOUT": p.ERR_TIMEOUT,
    "CM_ICAP_CAP_READ": p.ICAP_CAP_READ,
    "CM_ICAP_READ_SIZE_VER0": p.ICAP_READ.size,
    "CM_ICAP_STATE_ERROR": p.STATE_ERROR,
    **{f"CM_{name}": getattr(p, name) for name in dir(p) if name.startswith(("DMA_IOC_", "ICAP_IOC_"))},
}


def offsets(form: struct.Struct) -> list[int]:
    """Where each field begins."""
    codes = [code for code in form.format.lstrip("<") if code.isalpha()] if "s" not in form.format else None
    if codes is None:
        codes = [*form.format.lstrip("<").removesuffix("32s"), "32s"]
    return [struct.calcsize("<" + "".join(codes[:index])) for index in range(len(codes))]


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> dict[str, int]:
    """The compiler's value of each expression."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("needs a C compiler")
    expressions = [*NUMBERS, *(f"sizeof({name})" for name in SIZES)]
    for name, fields in FIELDS.items():
        expressions += [f"__builtin_offsetof({name}, {field})" for field in fields.split()]
    lines = "".join(f'printf("%llu\\n", (unsigned long long)({expression}));\n' for expression in expressions)
    folder = tmp_path_factory.mktemp("uapi")
    source = folder / "print.c"
    headers = "".join(f'#include "{name}"\n' for name in ("cm_node.h", "cm_dma.h", "cm_icap.h", "linux/gpio.h"))
    source.write_text(f"#include <stdio.h>\n{headers}int main(void) {{\n{lines}return 0;\n}}\n")
    subprocess.run([compiler, "-I", str(UAPI), "-o", str(folder / "print"), str(source)], check=True)
    output = subprocess.run([folder / "print"], check=True, capture_output=True, text=True).stdout
    return dict(zip(expressions, map(int, output.split()), strict=True))


def test_structures_and_numbers_are_those_of_the_headers(compiled):
    """Sizes, where each field begins, and every constant, in one comparison that shows what differs."""
    ours = {f"sizeof({name})": form.size for name, form in SIZES.items()} | NUMBERS
    for name, fields in FIELDS.items():
        places = zip(fields.split(), offsets(SIZES[name]), strict=True)
        ours |= {f"__builtin_offsetof({name}, {field})": place for field, place in places}
    assert ours == compiled


def test_a_shorter_structure_counts_as_padded_with_zeros():
    assert p.unpack(p.DMA_SUBMIT, struct.pack("<IIII", 16, 1, 7, 0)) == (1, 7, 0, 0, 0, 0, 0)


def test_a_longer_structure_with_zeros_is_taken():
    assert p.unpack(p.DMA_CANCEL, struct.pack("<III", 12, 0, 0)) == (0,)


def test_a_longer_structure_with_unknown_values_is_refused():
    with pytest.raises(NodeError) as caught:
        p.unpack(p.DMA_CANCEL, struct.pack("<III", 12, 0, 5))
    assert caught.value.number == errno.E2BIG


@pytest.mark.parametrize("payload", [b"", b"\0" * 7, struct.pack("<II", 99, 0)])
def test_a_structure_whose_size_is_not_its_own_is_refused(payload):
    with pytest.raises(NodeError) as caught:
        p.unpack(p.DMA_CANCEL, payload)
    assert caught.value.number == errno.EINVAL
