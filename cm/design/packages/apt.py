# SPDX-License-Identifier: Apache-2.0
"""apt-get with its own sources, lists and state.

The lists are verified with Debian's archive keys, each package with the lists' hashes: apt does both.
The machine's own settings (a proxy, say) stay; its sources, its lists and its state are not used.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from cm.errors import CmError

KEYRING = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
_SECONDS = 1800.0  # for one call: a slow line, and packages of hundreds of megabytes
_LINES = 8  # lines of a program's output that are shown if it fails


class PackagesUnavailable(CmError):
    """Packages cannot be fetched: a program is missing, there is no network, or there is no such package."""

    code = "packages_unavailable"


@dataclass(frozen=True, slots=True)
class Apt:
    """apt-get for one suite of one mirror, with its state in `state`."""

    state: Path
    mirror: str
    suite: str
    keyring: Path = KEYRING

    @property
    def _scratch(self) -> Path:
        return self.state / "tmp"

    def prepare(self) -> None:
        """Make the folders and the list of sources. Raises PackagesUnavailable if the keys to verify it are missing."""
        if not self.keyring.is_file():
            raise PackagesUnavailable(f"{self.keyring}: not there; install debian-archive-keyring to verify packages")
        shutil.rmtree(self._scratch, ignore_errors=True)
        for folder in ("lists/partial", "cache/archives/partial", self._scratch.name):
            (self.state / folder).mkdir(parents=True, exist_ok=True)
        (self.state / "status").touch()
        source = f"deb [signed-by={self.keyring}] {self.mirror} {self.suite} main\n"
        (self.state / "sources.list").write_text(source, encoding="utf-8")

    def update(self) -> None:
        """Fetch the lists; an expired or unsigned one is an error."""
        run(self._command("apt-get", "update", "-q", "-oAPT::Update::Error-Mode=any"), self._scratch)

    def download(self, names: list[str], place: Path) -> list[Path]:
        """Fetch packages and everything they depend on into `place`; return the files."""
        (place / "partial").mkdir(parents=True, exist_ok=True)
        options = [f"-oDir::Cache::archives={place}", "-q", "-y", "--no-install-recommends", "--download-only"]
        run(self._command("apt-get", "install", *options, "--", *names), self._scratch)
        return sorted(place.glob("*.deb"))

    def _command(self, tool: str, *arguments: str) -> list[str]:
        settings = {
            "Dir::State": self.state,
            "Dir::State::lists": self.state / "lists",
            "Dir::State::status": self.state / "status",
            "Dir::Cache": self.state / "cache",
            "Dir::Etc::sourcelist": self.state / "sources.list",
            "Dir::Etc::sourceparts": "-",
            "Dir::Etc::preferencesparts": self.state / "none",
            "APT::Sandbox::User": "",
            "APT::Get::AllowUnauthenticated": "false",
            "Acquire::AllowInsecureRepositories": "false",
            "Acquire::Languages": "none",
            "Acquire::Retries": "5",
            "APT::Update::Post-Invoke": "",
            "APT::Update::Post-Invoke-Success": "",
            "DPkg::Pre-Invoke": "",
            "DPkg::Post-Invoke": "",
        }
        return [tool, *(f"-o{name}={value}" for name, value in settings.items()), *arguments]


def run(command: list[str], scratch: Path | None = None) -> str:
    """Run a program and return its output.

    Raises PackagesUnavailable with its last lines if it fails. `scratch`: the folder for its temporary files, which a
    killed program leaves behind.
    """
    environment = {**os.environ, "LC_ALL": "C", "DEBIAN_FRONTEND": "noninteractive"}
    if scratch is not None:
        environment["TMPDIR"] = str(scratch)
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_SECONDS,
            env=environment,
            stdin=subprocess.DEVNULL,
            check=False,
        )
    except FileNotFoundError as error:
        raise PackagesUnavailable(f"{command[0]}: not there; it comes with Debian and Ubuntu") from error
    except subprocess.TimeoutExpired as error:
        raise PackagesUnavailable(f"{command[0]}: not done after {_SECONDS:.0f} seconds") from error
    if done.returncode:
        said = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
        raise PackagesUnavailable(f"{command[0]} failed: " + "; ".join(said[-_LINES:]))
    return done.stdout


def own_mirror() -> str:
    """Return the mirror from which this machine gets its Debian packages. Raises PackagesUnavailable."""
    found = run(["apt-get", "indextargets", "--format", "$(REPO_URI)"]).split()
    mirror = next((uri.rstrip("/") for uri in found if re.search(r"/debian/?$", uri)), None)
    if mirror is None:
        raise PackagesUnavailable("apt's sources name no Debian mirror: say which one (Ubuntu's has other packages)")
    return mirror
