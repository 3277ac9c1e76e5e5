# SPDX-License-Identifier: Apache-2.0
"""The real etcd: with certificates and users, a lease that ends, a watch through a restart."""

from __future__ import annotations

import asyncio
import json
import subprocess
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from fleet_etcd import EtcdCluster
from manager_process import until

from cm.networks.fleet.coordinator import Coordinator
from cm.networks.fleet.etcd import Cluster, Etcd
from cm.networks.fleet.security.certificates import authority, issued
from cm.networks.fleet.store import Put, Settings, StoreRefused, key, packed, views
from cm.tools.demo.boards import free_ports
from cm.wire.messages.fleet import Decision, FleetState, FleetStep


def test_keys_under_a_lease_go_when_it_is_not_kept() -> None:
    async def run(cluster: Cluster) -> None:
        store = Etcd(cluster)
        lease = "7"
        found = await store.claim({"a": 0}, {"a": Put("x", lease), "b": Put("y")}, lease, 2)
        assert {name: entry.value for name, entry in found.items()} == {"a": "x", "b": "y"}
        assert await store.claim({"a": 0}, {"b": Put("z")}, lease, 2) == found  # as after a lost answer
        assert await store.keep(lease)
        while "a" in await store.get(""):
            await asyncio.sleep(0.1)
        assert set(await store.get("")) == {"b"}
        assert not await store.keep(lease)
        await store.close()

    with EtcdCluster() as etcd:
        asyncio.run(asyncio.wait_for(run(Cluster((etcd.urls,))), 30.0))


def test_126_boards_are_changed_at_once_without_an_option_of_etcd() -> None:
    async def there(boards: Sequence[str], verb: str, step: FleetStep) -> AsyncIterator[tuple[str, FleetState]]:
        state = {"prepare": "prepared", "apply": "changed"}.get(verb, "there")
        for board in boards:
            yield board, FleetState(state, step.generation, config_name="camera", mode="edge")

    async def run(cluster: Cluster) -> None:
        store = Etcd(cluster)
        boards = [f"b{number:03}" for number in range(126)]
        course = await Coordinator(store, there, "anna", "c1", lambda _: (boards, {}), mode="edge").run()
        assert course.decision is Decision.KEEP
        assert {view.generation for view in views(await store.get("")).values()} == {1}
        await store.close()

    with EtcdCluster() as etcd:
        asyncio.run(asyncio.wait_for(run(Cluster((etcd.urls,))), 60.0))


def test_a_watch_goes_on_when_its_member_was_killed_and_is_there_again() -> None:
    async def run(etcd: EtcdCluster) -> None:
        store = Etcd(Cluster((etcd.urls,)))
        told = store.watch("boards/b1/").__aiter__()
        await anext(told)
        etcd.members[0].kill()
        etcd.members[0].start()
        until(etcd.members[0].healthy)
        await store.txn({}, {key("b1", "wanted"): Put("x")})
        while not await store.get("boards/b1/"):
            await anext(told)
        await anext(told)  # of the gap, or of what was put
        await store.close()

    with EtcdCluster() as etcd:
        asyncio.run(asyncio.wait_for(run(etcd), 60.0))


def test_with_certificates_and_users_a_board_writes_its_own_settings_and_nothing_else(tmp_path: Path) -> None:
    ca = authority("etcd of a test")
    own = issued(ca, "localhost", 2, ("127.0.0.1",))
    (tmp_path / "ca.pem").write_bytes(ca.certificate)
    (tmp_path / "own.pem").write_bytes(own.certificate)
    (tmp_path / "own.key").write_bytes(own.key)
    port = free_ports(2)
    url, peer = f"https://127.0.0.1:{port}", f"http://127.0.0.1:{port + 1}"
    files = ("--cert-file", str(tmp_path / "own.pem"), "--key-file", str(tmp_path / "own.key"))
    command = [
        "etcd", "--data-dir", str(tmp_path / "data"), "--listen-client-urls", url, "--advertise-client-urls", url,
        "--listen-peer-urls", peer, "--initial-advertise-peer-urls", peer, "--initial-cluster", f"default={peer}",
        "--log-level", "error", *files,
    ]  # fmt: skip
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as etcd:
        try:
            until(lambda: _ctl(tmp_path, url, "endpoint", "health").returncode == 0)
            for line in (
                "user add root:secret", "user grant-role root root", "user add b1:word", "role add board-b1",
                "role grant-permission board-b1 --prefix=true read cm/boards/b1/",
                "role grant-permission board-b1 readwrite cm/boards/b1/settings", "user grant-role b1 board-b1",
                "auth enable",
            ):  # fmt: skip
                _ctl(tmp_path, url, *line.split())
            (tmp_path / "word").write_text("word\n")
            about = {"members": [url], "cacert": str(tmp_path / "ca.pem"), "user": "b1"}
            (tmp_path / "store.json").write_text(json.dumps({**about, "password_file": str(tmp_path / "word")}))
            asyncio.run(asyncio.wait_for(_as_a_board(str(tmp_path / "store.json")), 30.0))
        finally:
            etcd.kill()


def _ctl(folder: Path, url: str, *arguments: str) -> Any:
    where = ["--endpoints", url, "--cacert", str(folder / "ca.pem")]
    env = {"ETCDCTL_API": "3", "PATH": "/usr/bin:/bin:/usr/local/bin"}
    return subprocess.run(["etcdctl", *where, *arguments], env=env, capture_output=True, check=False)


async def _as_a_board(about: str) -> None:
    store = Etcd(Cluster.read(about))
    await store.join("b1", packed(Settings(("north",))))
    assert set(await store.get("boards/b1/")) == {"boards/b1/settings"}
    with pytest.raises(StoreRefused, match="permission denied"):
        await store.txn({}, {key("b1", "wanted"): Put("x")})
    with pytest.raises(StoreRefused, match="permission denied"):
        await store.get("")
    gaps = []

    async def watch() -> None:
        async for changes in store.watch("boards/b2/"):
            gaps.append(changes)

    with pytest.raises(asyncio.TimeoutError):  # what it may not read is asked for twice in that time
        await asyncio.wait_for(watch(), 2.0)
    assert gaps == [{}, {}]
    await store.close()
