# SPDX-License-Identifier: Apache-2.0
"""HDL of others: what is found in modules of public repositories, beside verdicts written from their sources.

    python tests/corpus/hdl_corpus.py FOLDER            # one folder below for each repository (owner+name)
    python tests/corpus/hdl_corpus.py FOLDER --say REPOSITORY TOP…    # what is found now

A verdict is a line of `hdl_verdicts.tsv`: repository, module, parameters, and what there is to find, in the order of
the source: clocks; resets with + or - and their clocks (`?`: a person has to say which); buses with protocol, side,
clock and reset; interrupts; and `ask:` with the streams that only a person knows.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path

from cm.design.hdl.extract import Sources
from cm.design.hdl.model import ModuleInfo, Polarity
from cm.design.input_kinds import Given, read_inputs
from cm.frozen import dataclass

VERDICTS = Path(__file__).with_name("hdl_verdicts.tsv")
# by repository: the folders and the ending of what synthesis reads
FILES = {
    "fpganinja+taxi": (("src/axis/rtl", "src/axi/rtl", "src/apb/rtl", "src/eth/rtl", "src/lss/rtl"), ".sv"),
    "pulp-platform+axi": (("src",), ".sv"),
    "hdl-modules+hdl-modules": (("modules",), ".vhd"),
    "slaclab+surf": (("axi", "base", "protocols/i2c", "protocols/uart", "protocols/batcher"), ".vhd"),
    "PandABlocks+PandABlocks-FPGA": (("modules", "common"), ".vhd"),
    "Xilinx+finn": (("finn-rtllib",), ".v .sv"),
    "open-logic+open-logic": (("src",), ".vhd"),
    "strath-sdr+rfsoc_qpsk": (("boards/ip/iprepo",), "component.xml"),
    "stnolting+neorv32": (("rtl",), ".vhd"),
    "ZipCPU+wb2axip": (("rtl",), ".v"),
    "analogdevicesinc+hdl": (("library",), ".v"),
    "alexforencich+verilog-ethernet": (("rtl",), ".v"),
    "litex-hub+pythondata-cpu-vexriscv": (("pythondata_cpu_vexriscv/verilog/VexRiscv_Linux.v",), ""),
}
LEFT_OUT = ("/tb", "/test", "/sim", "_tb", "template", "/regression")


@dataclass(frozen=True, slots=True)
class Case:
    """One module, and what a person found in its source."""

    repository: str
    top: str
    parameters: str
    wanted: str


def cases() -> Iterator[Case]:
    """All verdicts."""
    for line in VERDICTS.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            yield Case(*line.split("\t"))


def files(corpus: Path, repository: str) -> list[Path]:
    """What is read of a repository."""
    folders, endings = FILES[repository]
    root = corpus / repository
    found = [root / name for name in folders if (root / name).is_file()]
    for folder in folders:
        found += [path for ending in endings.split() for path in sorted((root / folder).rglob(f"*{ending}"))]
    return [path for path in found if not any(word in str(path.relative_to(root)) for word in LEFT_OUT)]


def say(info: ModuleInfo) -> str:
    """What was found, as a verdict has it."""
    level = {Polarity.LOW: "-", Polarity.HIGH: "+", None: "*"}
    words = [clock.port for clock in info.clocks]
    words += [
        f"{reset.port}{level[reset.polarity]}{reset.clock or ('?' if reset.may_be else '')}" for reset in info.resets
    ]
    words += [
        f"{bus.name}={bus.protocol}:{bus.mode.value[0]}@{bus.clock or '?'}/{bus.reset or '-'}"
        for bus in info.interfaces
    ]
    words += [f"irq:{interrupt.port}" for interrupt in info.interrupts]
    near = dict.fromkeys(left.reason.split(", but")[0] for left in info.leftovers if ", but" in left.reason)
    words += [f"near:{reason.rpartition(' ')[2]}" for reason in near if reason.startswith("looks like the")]
    return " ".join([*words, *([f"ask:{','.join(info.asked)}"] if info.asked else [])])


def modules(corpus: Path, repository: str, wanted: Iterable[tuple[str, str]]) -> Iterator[tuple[str, str, str]]:
    """Yield (module, parameters, what is found in it), as its flat wrapper shows it if it needs one."""
    paths = files(corpus, repository)
    every = {one.info.name: one for one in read_inputs(Sources(paths), every=True)[0]}
    for top, text in wanted:
        given: Given | None = every.get(top)
        if given is not None and text:
            parameters = dict(item.split("=") for item in text.split(","))
            given = read_inputs(Sources(given.files or paths, top, parameters=parameters))[0][0]
        yield top, text, "no such module" if given is None else say(given.flat)


def judged(corpus: Path) -> Iterator[tuple[Case, str]]:
    """Yield each case of the repositories that are there, with what is found now."""
    groups: dict[str, list[Case]] = {}
    for case in cases():
        groups.setdefault(case.repository, []).append(case)
    for repository, some in groups.items():
        if (corpus / repository).is_dir():
            found = modules(corpus, repository, [(case.top, case.parameters) for case in some])
            yield from ((case, said) for case, (_, _, said) in zip(some, found, strict=True))


def asked(case: Case) -> bool:
    """Whether a person has to say something."""
    return "ask:" in case.wanted or "?" in case.wanted


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("corpus", type=Path, metavar="FOLDER")
    parser.add_argument("--say", nargs="+", metavar="NAME", help="print what is found in modules of a repository")
    args = parser.parse_args()
    if args.say:
        repository, *tops = args.say
        for found in modules(args.corpus, repository, [(top, "") for top in tops]):
            print(repository, *found, sep="\t")
        return 0
    wrong = [(case, said) for case, said in judged(args.corpus) if said != case.wanted]
    for case, said in wrong:
        print(f"{case.repository} {case.top}\n  by hand: {case.wanted}\n  found:   {said}")
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
