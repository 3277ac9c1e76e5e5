# SPDX-License-Identifier: Apache-2.0
"""The frame of the command line: status, errors, help and completion."""

from __future__ import annotations

import errno
import io
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import cm.cli.commands
from cm._version import __version__
from cm.cli.commands import COMMANDS, Command
from cm.cli.common import add_connection_options, print_json, print_table
from cm.cli.completion import SHELLS, script
from cm.cli.main import main
from cm.cli.parser import Parser
from cm.errors import Busy

CAMERA = Path(cm.cli.commands.__file__).parents[1] / "data" / "camera" / "camera.yaml"


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Install a command `try` that does what the test gives it to do."""

    def install(run: Any) -> None:
        module = ModuleType("a_command")

        def fill_parser(parser: Any) -> None:
            parser.add_argument("--json", action="store_true")
            parser.add_argument("--longer", action="store_true")
            parser.add_argument("--kind", choices=["red", "blue"], help="it's a: kind")
            parser.set_defaults(run=run)
            nested = parser.add_subparsers(required=False)
            nested.add_parser("inject", help="order a fault").add_argument("--root")

        module.fill_parser = fill_parser  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "a_command", module)
        own = [command for command in COMMANDS if command.name in ("config", "completion")]
        table = (*own, Command("try", "a_command", "try something"))
        monkeypatch.setattr("cm.cli.commands.COMMANDS", table)
        monkeypatch.setattr("cm.cli.parser.COMMANDS", table)

    return install


def fails_with(error: BaseException) -> Any:
    def run(args: Any) -> int:
        raise error

    return run


def usage_error(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    return capsys.readouterr().err


def test_a_command_gives_the_exit_status(command: Any) -> None:
    command(lambda args: 1)
    assert main(["try"]) == 1


def test_an_error_of_the_field_is_one_line_on_stderr(command: Any, capsys: pytest.CaptureFixture[str]) -> None:
    command(fails_with(Busy("region prr0 is loading")))
    assert main(["try"]) == 1
    assert capsys.readouterr() == ("", "cm: region prr0 is loading [busy]\n")


def test_an_error_is_json_where_json_was_asked_for(command: Any, capsys: pytest.CaptureFixture[str]) -> None:
    command(fails_with(Busy("region prr0 is loading")))
    assert main(["try", "--json"]) == 1
    assert json.loads(capsys.readouterr().out) == {"error": {"code": "busy", "message": "region prr0 is loading"}}


def test_an_error_of_the_system_names_the_file(command: Any, capsys: pytest.CaptureFixture[str]) -> None:
    command(fails_with(PermissionError(13, "Permission denied", "/dev/uio0")))
    assert main(["try"]) == 1
    assert capsys.readouterr().err == "cm: /dev/uio0: Permission denied\n"


def test_ctrl_c_ends_quietly(command: Any, capsys: pytest.CaptureFixture[str]) -> None:
    command(fails_with(KeyboardInterrupt()))
    assert main(["try"]) == 130
    assert capsys.readouterr() == ("", "")


def test_a_defect_of_the_program_is_not_hidden(command: Any) -> None:
    command(fails_with(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        main(["try"])


def test_options_are_not_abbreviated(command: Any, capsys: pytest.CaptureFixture[str]) -> None:
    command(lambda args: 0)
    assert main(["try", "--longer"]) == 0
    assert "--long" in usage_error(["try", "--long"], capsys)


def test_no_command_is_a_usage_error_that_shows_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "commands of every day:" in capsys.readouterr().err


def test_the_page_of_the_docs_has_every_command() -> None:
    page = (CAMERA.parents[3] / "docs" / "cli.md").read_text()
    rows = "\n".join(f"- `cm {command.name}`: {command.help}" for command in COMMANDS)
    assert rows in page


@pytest.mark.parametrize("words", [["reg", "write"], ["status"], []])
def test_help_of_a_command_is_what_its_option_prints(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    by_option = capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["help", *words])
    assert capsys.readouterr().out == by_option


@pytest.mark.parametrize(("columns", "longest"), [("60", 58), ("130", 128), ("wide", 78), ("0", 78)])
def test_help_is_as_wide_as_the_terminal(
    columns: str, longest: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", columns)  # if it is not a number, stdout is asked, which is not a terminal here
    monkeypatch.setattr("os.get_terminal_size", lambda *_: (_ for _ in ()).throw(OSError("no terminal")))
    with pytest.raises(SystemExit):
        main(["serve", "--help"])
    assert longest - 15 < max(map(len, capsys.readouterr().out.splitlines())) <= longest


@pytest.mark.parametrize(
    ("line", "usage"),
    [
        ("plan a b c", "usage: cm plan [-h]"),
        ("reg read --nmae", "usage: cm reg read [-h]"),
        ("reg write focus", "usage: cm reg write [-h]"),
        ("stream capture camera x.png y.png", "usage: cm stream capture [-h]"),
        ("sim inject", "usage: cm sim inject [-h]"),
        ("build check --no-such", "usage: cm build check [-h]"),
        ("bitstream verify", "usage: cm bitstream verify [-h]"),
    ],
)
def test_wrong_usage_shows_the_usage_of_that_command(
    line: str, usage: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CM_ROOT", raising=False)
    assert usage_error(line.split(), capsys).startswith(usage)


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out == f"cm {__version__}\n"


@pytest.mark.parametrize(
    ("module", "words"),
    [
        ("cm.cli.nowhere", "is not part of this installation"),
        ("needs_nowhere", "needs the Python module nowhere"),
        ("is_broken", "cannot be used here: cannot import name 'nothing'"),
    ],
)
def test_a_command_that_cannot_be_imported_says_why(
    module: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "needs_nowhere.py").write_text("import nowhere\n")
    (tmp_path / "is_broken.py").write_text("from os import nothing\n")
    monkeypatch.syspath_prepend(tmp_path)
    table = (Command("try", module, "try something"),)
    monkeypatch.setattr("cm.cli.commands.COMMANDS", table)
    monkeypatch.setattr("cm.cli.parser.COMMANDS", table)
    assert main(["try"]) == 1
    assert words in capsys.readouterr().err


def run_python(code: str, **kwargs: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False, **kwargs
    )


def test_help_imports_no_command_and_no_library() -> None:
    code = (
        "import sys\nfrom cm.cli.main import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
        "print([n for n in sys.modules if n in ('yaml', 'zmq', 'numpy', 'google', 'fastjsonschema', 'cm.cli.config')])"
    )
    assert run_python(code).stdout.endswith("[]\n")


def test_check_says_that_a_schema_is_good(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(CAMERA), str(CAMERA.parent)]) == 0
    assert capsys.readouterr().out == f"{CAMERA}: good: configuration camera, 5 modes\n" * 2


def test_check_prints_problems_as_compilers_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text("config:\n  name: c\n  modes: {m: {}}\n  devise: x\n")
    assert main(["check", str(CAMERA), str(bad)]) == 1
    assert f"{bad}:4:3: config.devise: unknown key 'devise' (did you mean device?)\n" in capsys.readouterr().out


def test_check_reports_in_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a.yaml", "b.yaml"):
        (tmp_path / name).write_text("config: {name: one, modes: {m: {}}}")
    assert main(["check", "--json", str(tmp_path)]) == 1
    report = json.loads(capsys.readouterr().out)
    assert [(file["good"], file["config_name"]) for file in report["files"]] == [(True, "one"), (False, "one")]
    assert report["files"][1]["problems"][0]["code"] == "duplicate_name"


def test_check_reads_from_stdin(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("config: {name: c, modes: {m: {}}, x: 1}"))
    assert main(["check", "-"]) == 1
    assert capsys.readouterr().out.startswith("-:1:35: config.x: unknown key 'x'")


def test_check_refuses_a_missing_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(tmp_path / "none.yaml"), str(tmp_path)]) == 1
    out = capsys.readouterr().out.splitlines()
    assert out[0] == f"{tmp_path}/none.yaml: no such file"
    assert "no runtime schema here" in out[1]


@pytest.mark.parametrize("settings", [(), ("--settings",)])
def test_check_goes_on_behind_a_file_that_may_not_be_read(
    settings: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    too_long = "x" * 300  # refused to root, too
    assert main(["check", *settings, too_long, "none.yaml"]) == 1
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith(f"{too_long}: {os.strerror(errno.ENAMETOOLONG)}")
    assert second.startswith("none.yaml: ")


def test_check_without_a_file_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert "which FILE?" in usage_error(["check"], capsys)


def test_connection_options_exclude_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    parser = Parser()
    add_connection_options(parser)
    assert parser.parse_args(["--runtime-dir", "/x"]).runtime_dir == Path("/x")
    with pytest.raises(SystemExit):
        parser.parse_args(["--runtime-dir", "/x", "--connect", "tcp://y"])


def test_a_table_has_its_numbers_on_the_right(capsys: pytest.CaptureFixture[str]) -> None:
    print_table([("focus", 2, "lens"), ("threshold", 255, None)], ("name", "value", "doc"))
    assert capsys.readouterr().out == "name       value  doc\nfocus          2  lens\nthreshold    255\n"


def test_json_takes_paths_and_mapping_proxies(capsys: pytest.CaptureFixture[str]) -> None:
    from types import MappingProxyType

    print_json(MappingProxyType({"path": Path("/x")}), lines=True)
    assert capsys.readouterr().out == '{"path": "/x"}\n'


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.programs if name != "bash" else ()) for name in SHELLS]
)
def test_a_completion_script_is_valid_in_its_shell(name: str, tmp_path: Path) -> None:
    if shutil.which(name) is None:
        pytest.skip(f"needs_{name}")
    file = tmp_path / "script"
    file.write_text(script(name))
    told = subprocess.run([name, "-n", str(file)], capture_output=True, text=True, timeout=30, check=True)
    assert told.stderr == ""


def test_without_argcomplete_the_command_names_what_brings_it_and_tab_does_nothing(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    for name in ("argcomplete", "argcomplete.shell_integration"):
        monkeypatch.setitem(sys.modules, name, None)
    assert main(["completion", "bash"]) == 1
    assert "pip install argcomplete, or Debian's python3-argcomplete" in capfd.readouterr().err
    for name, value in {"_ARGCOMPLETE": "1", "COMP_LINE": "cm mode ", "COMP_POINT": "8"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "argv", ["cm", "keygen", "must-not-run"])
    assert main() == 1
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("device", "said"),
    [
        ("xc7z02", "device: the IDCODE of xc7z02 is not known (did you mean xc7z020?)"),
        ("xc7z020-clg400-1", ""),
        ("mine, idcode: 0x1234093", ""),
    ],
)
def test_a_device_that_is_not_known_is_noted_with_the_nearest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], device: str, said: str
) -> None:
    modules = "modules: {one: {}}, modes: {m: {modules: [one]}}"
    (tmp_path / "b.yaml").write_text(f"config: {{name: b, device: {device}, {modules}}}\n")
    assert main(["config", "check", str(tmp_path / "b.yaml")]) == 0  # the name in its bitstreams is compared
    assert [line.partition("note: ")[2].partition(";")[0] for line in capsys.readouterr().out.splitlines()[1:]] == (
        [said] if said else []
    )


def test_a_bitstream_that_a_schema_names_and_nobody_has_is_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "b.yaml").write_text(
        "config: {name: b, modules: {one: {bitstream: one.bit}, two: {}}, modes: {m: {modules: [one]}}}\n"
    )
    assert main(["config", "check", str(tmp_path / "b.yaml")]) == 0  # it may be where the board is
    good, note = capsys.readouterr().out.splitlines()
    assert note.startswith(
        f"{tmp_path}/b.yaml: note: configuration b: module one of region prr0 (key bitstream): no file one.bit: "
    )
    (tmp_path / "one.bit").touch()
    assert main(["config", "check", str(tmp_path / "b.yaml")]) == 0
    assert capsys.readouterr().out.splitlines() == [good]
