# SPDX-License-Identifier: Apache-2.0
"""Run the device suite on a board: ``over_ssh.py --target USER@HOST [--board-file FILE] [pytest…]``.

The board needs Python 3.10 with this package and pytest (``--python`` says which), and somebody who may open the
devices. The suite is copied to a folder of its own there and removed afterwards; the exit status is pytest's.
"""

from __future__ import annotations

import argparse
import io
import shlex
import subprocess
import sys
import tarfile
from pathlib import Path

SUITE = Path(__file__).parent
NEEDS_SSH = 255  # what ssh exits with when it did not get there


def main(arguments: list[str]) -> int:
    """Copy, run, remove; the exit status."""
    options, rest = _options(arguments)
    ssh = _ssh(options)
    script = _script(options, rest)
    done = subprocess.run([*ssh, script], input=_packed(options.board_file), check=False)
    if done.returncode == NEEDS_SSH:
        print(f"device suite: {' '.join(ssh)} did not get to the board", file=sys.stderr)
    return done.returncode


def _options(arguments: list[str]) -> tuple[argparse.Namespace, list[str]]:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--target", metavar="USER@HOST", help="the board")
    where.add_argument("--lab", type=Path, metavar="ENV.yaml", help="a labgrid environment that says where it is")
    parser.add_argument("--place", default="main", help="target of the labgrid environment")
    parser.add_argument("--board-file", type=Path, help="JSON with the fields of tests/device/suite_board.py")
    parser.add_argument("--python", default="python3", help="on the board, with this package and pytest")
    parser.add_argument("--sudo", action="store_true", help="run as root over there")
    return parser.parse_known_args(arguments)


def _ssh(options: argparse.Namespace) -> list[str]:
    command = ["ssh", "-o", "BatchMode=yes"]
    if options.lab is None:
        return [*command, options.target]
    service = _service(options.lab, options.place)
    user = f"{service['username']}@" if "username" in service else ""
    return [*command, "-p", str(service.get("port", 22)), f"{user}{service['address']}"]


def _service(environment: Path, place: str) -> dict[str, object]:
    """The NetworkService of a target of a labgrid environment."""
    import yaml

    targets = (yaml.safe_load(environment.read_text("utf-8")) or {}).get("targets", {})
    service = targets.get(place, {}).get("resources", {}).get("NetworkService")
    if not isinstance(service, dict) or "address" not in service:
        raise SystemExit(f"{environment}: target {place!r} has no NetworkService with an address")
    return service


def _script(options: argparse.Namespace, rest: list[str]) -> str:
    """What the board's shell does: everything in one connection, nothing left behind."""
    pytest = [options.python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", "/dev/null", "--rootdir", "."]
    if options.sudo:
        pytest = ["sudo", *pytest]
    pytest += ["suite", "--board=hw", *rest]
    if options.board_file:
        pytest.append("--board-file=board.json")
    return (
        'set -e; folder=$(mktemp -d); trap \'rm -rf "$folder"\' EXIT; cd "$folder"; tar xf -; '
        f"PYTHONDONTWRITEBYTECODE=1 {shlex.join(pytest)}"
    )


def _packed(board_file: Path | None) -> bytes:
    data = io.BytesIO()
    with tarfile.open(fileobj=data, mode="w") as archive:
        for path in sorted(SUITE.glob("*.py")):
            archive.add(path, f"suite/{path.name}")
        if board_file:
            archive.add(board_file, "board.json")
    return data.getvalue()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
