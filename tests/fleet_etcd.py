# SPDX-License-Identifier: Apache-2.0
"""A cluster of etcd's members in processes of this machine, which can be killed and stopped one by one."""

from __future__ import annotations

import http.client
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType

import pytest
from manager_process import until

from cm.tools.demo.boards import free_ports

needs_etcd = pytest.mark.skipif(shutil.which("etcd") is None, reason="needs etcd (Debian: etcd-server)")


class Member:
    """One member; again after `kill`, from what is on its disk."""

    def __init__(self, name: str, client: str, command: Sequence[str], folder: Path) -> None:
        self.name, self.client, self._command, self._folder = name, client, command, folder
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        self._folder.mkdir(exist_ok=True)
        with (self._folder / "log").open("ab") as log:
            environment = {**os.environ, "ETCD_UNSUPPORTED_ARCH": os.uname().machine.replace("aarch64", "arm64")}
            self.process = subprocess.Popen(self._command, stdout=log, stderr=log, env=environment)

    def send(self, number: int) -> None:
        assert self.process is not None
        self.process.send_signal(number)

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None

    def healthy(self) -> bool:
        """Whether it answers, and has a leader."""
        host, _, port = self.client.partition("://")[2].partition(":")
        connection = http.client.HTTPConnection(host, int(port), timeout=1.0)
        try:
            connection.request("GET", "/health")
            return b'"true"' in connection.getresponse().read()
        except OSError:
            return False
        finally:
            connection.close()


class EtcdCluster:
    """As a context manager: `size` members, which all have a leader. `options` are etcd's."""

    def __init__(
        self,
        size: int = 1,
        folder: Path | None = None,
        options: Sequence[str] = (),
        host: Callable[[int], str] = lambda number: f"127.0.0.{1 + number}",
        inside: Callable[[int], Sequence[str]] = lambda _: (),
        port: int = 0,
    ) -> None:
        """`inside`: what begins the command of a member, such as ``ip netns exec``."""
        self.folder = Path(folder or tempfile.mkdtemp(prefix="cme-", dir="/tmp"))
        port = port or free_ports(2)
        peers = ",".join(f"m{n}=http://{host(n)}:{port + 1}" for n in range(size))
        self.members = []
        for n in range(size):
            client, peer = f"http://{host(n)}:{port}", f"http://{host(n)}:{port + 1}"
            command = [
                *inside(n), "etcd", "--name", f"m{n}", "--data-dir", str(self.folder / f"m{n}" / "data"),
                "--listen-client-urls", client, "--advertise-client-urls", client, "--listen-peer-urls", peer,
                "--initial-advertise-peer-urls", peer, "--initial-cluster", peers, "--initial-cluster-token",
                self.folder.name, "--log-level", "error", *options,
            ]  # fmt: skip
            self.members.append(Member(f"m{n}", client, command, self.folder / f"m{n}"))

    @property
    def urls(self) -> str:
        return ",".join(member.client for member in self.members)

    def __enter__(self) -> EtcdCluster:
        for member in self.members:
            member.start()
        until(lambda: all(member.healthy() for member in self.members), 180.0)  # on a disk that others keep busy
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        for member in self.members:
            if member.process is not None:
                member.send(signal.SIGCONT)
            member.kill()
        shutil.rmtree(self.folder, ignore_errors=True)
