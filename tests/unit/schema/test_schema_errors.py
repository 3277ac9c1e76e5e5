# SPDX-License-Identifier: Apache-2.0
"""Each mistake in a runtime schema has its own error, at its place, which says what would be right."""

from __future__ import annotations

from pathlib import Path

import pytest

import cm.schema
from cm.errors import NotFound
from cm.schema import Problem, SchemaError
from cm.schema.value_errors import name_form


def problems(text: str) -> list[Problem]:
    with pytest.raises(SchemaError) as caught:
        cm.schema.loads(text)
    return list(caught.value.problems)


def partial(body: str, modes: str = "modes: {default: {}}") -> str:
    """A configuration with `body`; § marks where the error is."""
    lines = [f"  {line}" for line in f"name: c\n{body}\n{modes}".splitlines()]
    return "\n".join(["config:", *lines])


# Each: what is wrong, code, key below config, words of the message or hint, text; § is where it is.
CASES = [
    ("unknown key", "unknown_key", "defualt_mode", "did you mean default_mode?", "§defualt_mode: default"),
    ("unknown key deep down", "unknown_key", "mmio[0].registers.r.ofset", "did you mean offset?",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, §ofset: 4}}}]"),
    ("missing key", "missing_key", "mmio[0].registers.r", "offset is missing",
     "mmio: [{base_address: 0, registers: {r: §{width: 32}}}]"),
    ("register without a window", "missing_key", "registers.r", "mmio", "registers: {§r: {offset: 0}}"),
    ("duplicate key", "duplicate_key", "type", "line 3", "type: partial\n§type: partial"),
    ("duplicate module", "duplicate_name", "modules.a", "line 3", "modules: {a: {}, §a: {}}"),
    ("duplicate module in a list", "duplicate_name", "modules.a", "again", "modules: [a, §a]"),
    ("duplicate register in one window", "duplicate_name", "mmio[0].registers.r", "again",
     "mmio: [{base_address: 0, registers: [r: [offset: 0], §r: [offset: 4]]}]"),
    ("duplicate register in two windows", "duplicate_name", "mmio[1].registers.r", "twice",
     "mmio:\n- {base_address: 0, registers: {r: {offset: 0}}}\n- {base_address: 16, registers: {§r: {offset: 0}}}"),
    ("duplicate overlay", "duplicate_name", "overlays[1]", "already", "overlays: [a, §a]"),
    ("bad name", "bad_name", "modules.a.b", "is not a name", "modules: {§a.b: {}}"),
    ("bad type", "bad_type", "device", "found 7020", "§device: 7020"),
    ("text where a number is meant", "bad_type", "mmio[0].base_address", "expected an integer, found 'x'",
     "mmio: [{§base_address: x, registers: {}}]"),
    ("number in quotes", "bad_type", "mmio[0].base_address", "without quotes",
     "mmio: [{§base_address: '0x10', registers: {}}]"),
    ("list where a map is meant", "bad_type", "regions", "expected a map, found a list", "§regions: [[a]]"),
    ("no such type", "bad_value", "type", "did you mean partial?", "§type: partail"),
    ("width that no bus has", "bad_value", "mmio[0].registers.r.width", "8, 16, 32, 64",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, §width: 24}}}]"),
    ("leading zero", "bad_value", "", "0o", "clocks: {fclk: §0100}"),
    ("leading zero and nothing else", "bad_value", "", "0o", "clocks: {fclk: §0_}"),
    ("more zeros than Python reads", "bad_value", "", "0o", f"clocks: {{fclk: §{'0' * 5000}}}"),
    ("name as a value", "bad_value", "default_mode", "beginning with a letter or _, at most 64", "§default_mode: a b"),
    ("sha256 too short", "bad_value", "modules.a.sha256", "64 hexadecimal digits", "modules: {a: {§sha256: abc}}"),
    ("negative address", "value_range", "mmio[0].base_address", "at least 0",
     "mmio: [{§base_address: -4, registers: {}}]"),
    ("the whole device by whatever port there is", "bad_value", "loader", "Only with `type: full`",
     "type: full\n§loader: auto"),
    ("default above max", "value_range", "mmio[0].registers.r.default", "from 0 to 3",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, max: 3, §default: 4}}}]"),
    ("default below min", "value_range", "mmio[0].registers.r.default", "from 1 to 255",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, width: 8, min: 1, §default: 0}}}]"),
    ("default wider than the register", "value_range", "mmio[0].registers.r.default", "at most 0xff",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, width: 8, §default: 0x100}}}]"),
    ("reset wider than the register", "value_range", "mmio[0].registers.r.reset", "at most 0xff",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, width: 8, §reset: 0x100}}}]"),
    ("min above max", "value_range", "mmio[0].registers.r.min", "above max",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, §min: 4, max: 3}}}]"),
    ("default of a read-only register", "not_applicable", "mmio[0].registers.r.default", "reset",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, access: ro, §default: 4}}}]"),
    ("default of a write-one-to-clear register", "not_applicable", "mmio[0].registers.r.default", "write-one-to-clear",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, access: w1c, §default: 4}}}]"),
    ("misaligned offset", "misaligned_offset", "mmio[0].registers.r.offset", "multiple of 4",
     "mmio: [{base_address: 0, registers: {r: {§offset: 2}}}]"),
    ("misaligned decoupler", "misaligned_offset", "regions.a.decoupler.offset", "multiple of 4",
     "regions: {a: {decoupler: {base_address: 0, §offset: 2}}}"),
    ("overlapping registers", "overlapping_registers", "mmio[0].registers.b", "config.mmio[0].registers.a",
     "mmio: [{base_address: 0, registers: {a: {offset: 0}, §b: {offset: 2, width: 16}}}]"),
    ("overlap through different windows", "overlapping_registers", "mmio[1].registers.b", "0x10",
     "mmio:\n- {base_address: 0, registers: {a: {offset: 16}}}\n- {base_address: 16, registers: {§b: {offset: 0}}}"),
    ("field wider than the register", "value_range", "mmio[0].registers.r.fields.f", "bits 7:0",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, width: 8, fields: {§f: {bits: 8:4}}}}}]"),
    ("overlapping fields", "field_overlap", "mmio[0].registers.r.fields.g", "f has bits 4:0",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, fields: {f: {bits: 4:0}, §g: {bits: 4}}}}}]"),
    ("bits the wrong way round", "bad_value", "mmio[0].registers.r.fields.f.bits", "highest bit first",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, fields: {f: {§bits: 0:4}}}}}]"),
    ("field without place", "missing_key", "mmio[0].registers.r.fields.f", "either bits",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, fields: {§f: {width: 4}}}}}]"),
    ("name of a value that does not fit", "value_range", "mmio[0].registers.r.fields.f.values.on", "at most 0x1",
     "mmio: [{base_address: 0, registers: {r: {offset: 0, fields: {f: {bits: 4, values: {§on: 2}}}}}}]"),
    ("what belongs to the build schema", "unknown_key", "modules.a.relocatable", "of the build schema",
     "modules: {a: {bitstream: a.bin, §relocatable: true}}"),
    ("unknown region of a module", "unknown_region", "modules.a.region", "did you mean left?",
     "regions: [left, right]\nmodules: {a: {§region: letf}}"),
    ("unknown region of a register", "unknown_region", "mmio[0].registers.r.region", "there is no region x",
     "mmio: [{base_address: 0, region: x, registers: {§r: {offset: 0}}}]"),
    ("unknown region of a stream", "unknown_region", "streams.s.region", "known: prr0",
     "streams: {s: {direction: s2mm, §region: x}}"),
    ("region left open", "missing_key", "modules.a", "left, right", "regions: [left, right]\nmodules: {§a: {}}"),
    ("region called static", "name_clash", "regions.static", "another name", "regions: [§static]"),
    ("decoupler without its register", "missing_key", "regions.a.decoupler", "the register, or in place of it gpio",
     "regions: {a: {§decoupler: {base_address: 0}}}"),
    ("two regions on one decoupler", "region_conflict", "regions.b.decoupler", "same decoupler bit",
     "regions:\n  a: {decoupler: {base_address: 0, offset: 0}}\n  b: {§decoupler: {base_address: 0, offset: 0}}"),
    ("footprint backwards", "value_range", "regions.a.footprint[0].columns", "[first, last]",
     "regions: {a: {footprint: [{row: 0, §columns: [4, 2]}]}}"),
    ("identity without a register", "missing_identity", "modules.a.identity", "no identity register",
     "modules: {a: {§identity: 1}}"),
    ("identity twice", "duplicate_identity", "modules.b.identity", "module a",
     "regions: {r: {identity: {base_address: 0, offset: 0}}}\nmodules: {a: {identity: 1}, b: {§identity: 1}}"),
    ("identity too wide", "value_range", "modules.a.identity", "8 bits",
     "regions: {r: {identity: {base_address: 0, offset: 0, width: 8}}}\nmodules: {a: {§identity: 256}}"),
    ("memory without a window", "missing_key", "memories.m", "mmio", "memories: {§m: {size: 4}}"),
    ("memory without a size", "missing_key", "memories.m", "size is missing", "memories: {m: §{base_address: 0}}"),
    ("empty window", "missing_key", "mmio[0]", "registers or memories", "mmio: [§{base_address: 0}]"),
    ("duplicate memory", "duplicate_name", "memories.m", "config.mmio[0].memories.m",
     "mmio: [{base_address: 0, memories: {m: {size: 4}}}]\nmemories: {§m: {base_address: 64, size: 4}}"),
    ("memory of no whole words", "bad_value", "memories.m.size", "8 or 12",
     "memories: {m: {base_address: 0, §size: 10}}"),
    ("memory of nothing", "value_range", "memories.m.size", "at least 4", "memories: {m: {base_address: 0, §size: 0}}"),
    ("memory beside the words", "misaligned_offset", "memories.m.offset", "a multiple of 4",
     "memories: {m: {base_address: 0, §offset: 2, size: 8}}"),
    ("memory at a base beside the words", "misaligned_offset", "memories.m.offset", "0x1001",
     "memories: {§m: {base_address: 0x1001, size: 8}}"),
    ("memory behind the last address", "value_range", "memories.m.size", "64 bits",
     "memories: {m: {base_address: 0xfffffffffffffffc, §size: 8}}"),
    ("access that no memory has", "bad_value", "memories.m.access", "rw, ro, wo",
     "memories: {m: {base_address: 0, size: 4, §access: w1c}}"),
    ("shape that is not the memory's", "bad_value", "memories.m.shape", "128 bytes",
     "memories: {m: {base_address: 0, size: 64, dtype: int16, §shape: [8, 8]}}"),
    ("elements that do not fill a memory", "bad_value", "memories.m.size", "a multiple of 8",
     "memories: {m: {base_address: 0, §size: 12, dtype: float64}}"),
    ("memory called as a stream", "name_clash", "memories.s", "config.streams.s",
     "streams: {s: {direction: s2mm}}\nmemories: {§s: {base_address: 0, size: 4}}"),
    ("unknown region of a memory", "unknown_region", "memories.m.region", "there is no region x",
     "memories: {m: {base_address: 0, size: 4, §region: x}}"),
    ("memory over a register", "overlapping_memory", "mmio[0].memories.m", "config.mmio[0].registers.r is at 0x8",
     "mmio: [{base_address: 0, registers: {r: {offset: 8}}, memories: {§m: {size: 16}}}]"),
    ("memories in one place", "overlapping_memory", "memories.b", "memory b overlaps memory a",
     "memories: {a: {base_address: 0, size: 16}, §b: {base_address: 12, size: 8}}"),
    ("memory over a decoupler", "overlapping_memory", "memories.m", "the decoupler of region a",
     "regions: {a: {decoupler: {base_address: 0, offset: 4}}}\nmemories: {§m: {base_address: 0, size: 64}}"),
    ("memory over an identity register", "overlapping_memory", "memories.m", "the identity of region a",
     "regions: {a: {identity: {base_address: 0, offset: 4}}}\nmemories: {§m: {base_address: 0, size: 64}}"),
    ("unknown default mode", "unknown_mode", "default_mode", "known: default", "§default_mode: x"),
    ("bitstream of a partial configuration", "not_applicable", "bitstream", "type: full", "§bitstream: a.bit"),
    ("bad dtype", "bad_dtype", "streams.s.dtype", "did you mean uint8?",
     "streams: {s: {direction: s2mm, §dtype: unit8}}"),
    ("bad shape", "value_range", "streams.s.shape[1]", "at least 1",
     "streams: {s: {direction: s2mm, shape: [1, §0]}}"),
    ("stream without direction", "missing_key", "streams.s", "direction is missing", "streams: {s: §{shape: [1]}}"),
    ("two streams on one channel", "channel_conflict", "streams.b", "channel dma0",
     "streams:\n  a: {direction: s2mm, channel: dma0}\n  §b: {direction: s2mm, channel: dma0}"),
    ("frame longer than a transfer", "too_long", "streams.s.shape", "has 16384 bytes, and the engine moves 16383",
     "streams: {s: {direction: s2mm, max_length: 16383, §shape: [64, 128], dtype: uint16}}"),
    ("packet longer than a transfer", "too_long", "streams.s.slot_bytes", "a wider length register",
     "streams: {s: {direction: s2mm, max_length: 255, §slot_bytes: 256}}"),
    ("encoding of other pixels", "encoding_mismatch", "streams.s.encoding", "mono8 would be",
     "streams: {s: {direction: s2mm, shape: [4, 4], §encoding: rgb8}}"),
    ("encoding without rows", "encoding_mismatch", "streams.s.encoding", "rows and columns",
     "streams: {s: {direction: s2mm, §encoding: mono8}}"),
    ("encoding that ROS does not have", "bad_value", "streams.s.encoding", "rbg8",
     "streams: {s: {direction: s2mm, shape: [4, 4, 3], §encoding: rbg8}}"),
    ("calibration without its matrix", "missing_key", "streams.s.camera_info", "camera_matrix",
     "streams: {s: {direction: s2mm, camera_info: §{image_width: 4, image_height: 4}}}"),
    ("matrix of the wrong size", "bad_value", "streams.s.camera_info.camera_matrix.data", "9",
     "streams: {s: {direction: s2mm, camera_info: {image_width: 4, image_height: 4, "
     "camera_matrix: {rows: 3, cols: 3, §data: [1, 2]}}}}"),
    ("interrupt without line", "missing_key", "interrupts.i", "uio", "interrupts: {§i: {}}"),
    ("interrupt with two lines", "name_clash", "interrupts.i.uio", "keep one",
     "interrupts: {i: {base_address: 0, §uio: a}}"),
    ("interrupt of an unknown register", "unknown_register", "interrupts.i.status", "did you mean stat?",
     "mmio: [{base_address: 0, registers: {stat: {offset: 0}}}]\n"
     "interrupts: {i: {base_address: 0, §status: sttat, bit: 0}}"),
    ("interrupt bit outside its register", "value_range", "interrupts.i.bit", "0 to 31",
     "mmio: [{base_address: 0, registers: {stat: {offset: 0}}}]\n"
     "interrupts: {i: {base_address: 0, status: stat, §bit: 32}}"),
    ("bit of no register", "missing_key", "interrupts.i.bit", "status", "interrupts: {i: {base_address: 0, §bit: 1}}"),
    ("acknowledge without bit", "missing_key", "interrupts.i.acknowledge", "bit",
     "mmio: [{base_address: 0, registers: {stat: {offset: 0}}}]\n"
     "interrupts: {i: {base_address: 0, status: stat, §acknowledge: true}}"),
    ("interrupts that cannot be told apart", "interrupt_conflict", "interrupts.j", "status register",
     "interrupts:\n  i: {base_address: 0}\n  §j: {base_address: 0}"),
    ("block with an unknown interrupt", "unknown_interrupt", "blocks.b.interrupts[0]", "did you mean done?",
     "interrupts: {done: {base_address: 0}}\nblocks: {b: {interrupts: [§doen]}}"),
    ("block that leads nowhere", "unknown_peer", "blocks.b.peers[0]", "", "blocks: {b: {peers: [§c]}}"),
    ("float of half a word", "value_range", "registers.r.type", "width: 32",
     "registers: {r: {base_address: 0, offset: 0, width: 16, §type: float32}}"),
    ("clock without rate", "missing_key", "clocks.fclk", "rate is missing", "clocks: {fclk: §{doc: x}}"),
    ("region called as what is in none", "name_clash", "regions.static", "static is everything outside the regions",
     "regions: {§static: {}}"),
    ("identity at an odd address", "misaligned_offset", "regions.a.identity.offset",
     "address 0x1002 of an access of 32 bits (a multiple of 4)",
     "regions: {a: {identity: {base_address: 0x1000, §offset: 2}}}"),
    ("memory in a region that is nearly the static part", "unknown_region", "memories.t.region",
     "did you mean static?", "memories: {t: {base_address: 0, size: 4, §region: statc}}"),
    ("register without an offset, and what that is", "missing_key", "mmio[0].registers.r",
     "offset is missing (Offset in bytes, a multiple of the width)",
     "mmio: [{base_address: 0, registers: {r: §{width: 32}}}]"),
    ("truth where a number or text is meant", "bad_type", "modules.a.identity", "found true",
     "regions: [r]\nmodules: {a: {§identity: true}}"),
    ("map where a list of modes is meant", "bad_type", "default_mode", "expected text, found a map",
     "§default_mode: {a: {}}"),
    ("timeout of nothing", "value_range", "regions.a.timeout", "more than 0", "regions: {a: {§timeout: 0}}"),
]  # fmt: skip

MODE_CASES = [
    ("unknown module", "unknown_module", "modes.m.modules[0]", "did you mean edge?", "m: {modules: [§egde]}"),
    ("module twice", "duplicate_name", "modes.m.modules[1]", "twice", "m: {modules: [edge, §edge]}"),
    ("two modules for one region", "region_conflict", "modes.m.modules[1]", "region prr0",
     "m: {modules: [edge, §blur]}"),
    ("overlay of the configuration again", "duplicate_name", "modes.m.overlays[0]", "already",
     "m: {overlays: [§base]}"),
    ("overlap with the static part", "overlapping_registers", "modes.m.mmio[0].registers.r",
     "config.mmio[0].registers.led",
     "m: {mmio: [{base_address: 0, registers: {§r: {offset: 0}}}]}"),
    ("overlap with the mode's module", "overlapping_registers", "modes.m.mmio[0].registers.r", "modules.edge",
     "m: {modules: [edge], mmio: [{base_address: 16, registers: {§r: {offset: 0}}}]}"),
    ("memory over a register of the mode's module", "overlapping_memory", "modes.m.memories.t",
     "threshold is at 0x10 to 0x13", "m: {modules: [edge], memories: {§t: {base_address: 16, size: 8}}}"),
    ("memory of the static part elsewhere", "name_clash", "modes.m.memories.table", "elsewhere",
     "m: {memories: {§table: {base_address: 0x200, size: 8}}}"),
    ("memory called as a stream of another mode", "name_clash", "modes.m.memories.other",
     "config.modes.n.streams.other",
     "m: {memories: {§other: {base_address: 0x200, size: 8}}}\n  n: {streams: {other: {direction: mm2s}}}"),
    ("name of the static part elsewhere", "name_clash", "modes.m.mmio[0].registers.led", "elsewhere",
     "m: {mmio: [{base_address: 64, registers: {§led: {offset: 0}}}]}"),
    ("mistyped stream", "missing_key", "modes.m.streams.camra", "did you mean camera?",
     "m: {streams: {§camra: {shape: [2]}}}"),
    ("stream moved onto another's channel", "channel_conflict", "modes.m.streams.other", "channel camera",
     "m: {streams: {§other: {direction: s2mm, channel: camera}}}"),
]  # fmt: skip
MODE_BASE = """\
modules:
  edge: {mmio: [{base_address: 16, registers: {threshold: {offset: 0}}}]}
  blur: {}
overlays: [base]
mmio: [{base_address: 0, registers: {led: {offset: 0}}}]
memories: {table: {base_address: 0x100, size: 64}}
streams: {camera: {direction: s2mm}}"""


def assert_one(text: str, code: str, key: str, words: str) -> None:
    before = text[: text.index("§")]
    line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
    (problem,) = problems(text.replace("§", ""))
    assert (problem.code, problem.line, problem.column) == (code, line, column), problem
    assert problem.key == (f"config.{key}" if key else "")
    assert words in str(problem)


@pytest.mark.parametrize(("code", "key", "words", "body"), [case[1:] for case in CASES], ids=[c[0] for c in CASES])
def test_a_mistake_is_named_at_its_place(code: str, key: str, words: str, body: str) -> None:
    assert_one(partial(body), code, key, words)


@pytest.mark.parametrize(
    ("code", "key", "words", "mode"), [case[1:] for case in MODE_CASES], ids=[c[0] for c in MODE_CASES]
)
def test_a_mistake_in_a_mode_is_named_at_its_place(code: str, key: str, words: str, mode: str) -> None:
    assert_one(partial(MODE_BASE, f"modes:\n  {mode}"), code, key, words)


def test_many_mistakes_are_reported_at_once_in_order() -> None:
    text = partial("type: no\ndevise: x\nmodules: {a: {identity: x, region: 5}}\nclocks: {f: {}}")
    assert [(p.line, p.code) for p in problems(text)] == [
        (3, "bad_value"),
        (4, "unknown_key"),
        (5, "bad_type"),
        (5, "bad_type"),
        (6, "missing_key"),
    ]


def test_a_name_that_is_nowhere_else_is_reported_beside_a_misspelt_key() -> None:
    """What the misspelt key may define is not: `edge`, `left`; nor what could follow from it."""
    text = partial(
        "modulse: [edge]\nregion: {left: {}}\ndefault_mode: othre\nstreams: {s: {direction: up, region: left}}",
        "modes: {default: {modules: [edgy]}, other: {modules: [edge]}, third: 3}",
    )
    found = [(p.code, p.key.removeprefix("config."), p.hint) for p in problems(text)]
    assert [one[:2] for one in found] == [
        ("unknown_key", "modulse"),
        ("unknown_key", "region"),
        ("unknown_mode", "default_mode"),
        ("bad_value", "streams.s.direction"),
        ("unknown_module", "modes.default.modules[0]"),
        ("bad_type", "modes.third"),
    ]
    assert (found[2][2], found[4][2]) == ("did you mean other?", "")  # not "there are none"


@pytest.mark.parametrize("text", ["just text", "[1, 2]", "config: 3", "config: {modes: {a: {modules: [x]}}}"])
def test_where_too_little_is_left_only_that_is_reported(text: str) -> None:
    assert [problem.code for problem in problems(text)][1:] == []


def test_several_mistakes_of_meaning_are_reported_at_once() -> None:
    text = partial("default_mode: x", "modes: {a: {modules: [b, c]}, d: {modules: [e]}}")
    assert [p.code for p in problems(text)] == ["unknown_mode"] + ["unknown_module"] * 3


def test_a_pair_that_overlaps_in_several_modes_is_reported_once() -> None:
    body = "mmio: [{base_address: 0, registers: {a: {offset: 0}, b: {offset: 0}}}]"
    assert len(problems(partial(body, "modes: {m: {}, n: {}}"))) == 1


def test_a_memory_that_overlaps_in_several_modes_is_reported_once() -> None:
    body = "mmio: [{base_address: 0, registers: {a: {offset: 0}}, memories: {b: {size: 8}}}]"
    assert len(problems(partial(body, "modes: {m: {}, n: {}}"))) == 1


def test_different_modes_may_use_one_address_for_different_memories() -> None:
    modes = "modes: {m: {memories: {a: {base_address: 0, size: 8}}}, n: {memories: {b: {base_address: 0, size: 8}}}}"
    config = cm.schema.loads(partial("", modes))
    assert [list(config.visible_memories(mode)) for mode in ("m", "n")] == [["a"], ["b"]]


def test_a_configuration_without_modes_is_refused() -> None:
    (problem,) = problems("config: {name: c}")
    assert (problem.code, problem.key) == ("missing_key", "config")
    assert "modes" in problem.message


def test_the_message_reads_as_compilers_write_theirs(tmp_path: Path) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text("config:\n  name: c\n  modes: {default: {}}\n  tipe: full\n")
    with pytest.raises(SchemaError) as caught:
        cm.schema.load(file)
    assert str(caught.value) == f"{file}:4:3: config.tipe: unknown key 'tipe' (did you mean type?)"
    assert caught.value.code == "schema_invalid"


def test_check_returns_the_problems_and_nothing_for_a_good_file(tmp_path: Path) -> None:
    bad, good = tmp_path / "bad.yaml", tmp_path / "good.yaml"
    bad.write_text("config: {name: c}\n")
    good.write_text("config: {name: c, modes: {default: {}}}\n")
    assert [problem.path for problem in cm.schema.check(bad)] == [bad]
    assert cm.schema.check(good) == []


def test_a_file_that_does_not_exist_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="no such file"):
        cm.schema.load(tmp_path / "none.yaml")


def test_a_folder_in_place_of_a_file_is_refused(tmp_path: Path) -> None:
    (problem,) = cm.schema.check(tmp_path)
    assert problem.code == "unreadable"


def test_each_sign_that_a_name_may_have_is_named_once() -> None:
    assert name_form("^[A-Za-z_][A-Za-z0-9_/-]{0,63}$") == (
        "letters, digits, _, / and -, beginning with a letter or _, at most 64 characters"
    )
