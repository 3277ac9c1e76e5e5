# SPDX-License-Identifier: Apache-2.0
"""Debian packages in a separate folder: from a repository that the tests make, without a network."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from cm.design.debian_packages import PackagesUnavailable, fetch

needs_apt = pytest.mark.skipif(
    not all(map(shutil.which, ("apt-get", "dpkg-deb", "gpg"))), reason="apt-get, dpkg-deb or gpg is not there"
)
CONTROL = """\
Package: {name}
Version: 1.0
Architecture: all
Maintainer: nobody <nobody@example.org>
Description: a test
"""


class Repository:
    """A signed repository in a folder, as apt reads it by its method `copy`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.keyring = folder / "keyring.gpg"
        self._gpg_home = Path(tempfile.mkdtemp(prefix="cm-gpg-"))  # a socket's path must be short
        folder.mkdir(parents=True)
        self._gpg("--quick-generate-key", "test@example.org", "default", "sign", "never")
        self.keyring.write_bytes(self._gpg("--export"))
        self.pool = folder / "dists/sid/main/binary-all"
        for name in self._binaries():
            name.mkdir(parents=True)

    def close(self) -> None:
        subprocess.run(["gpgconf", "--homedir", str(self._gpg_home), "--kill", "all"], capture_output=True, check=False)
        shutil.rmtree(self._gpg_home, ignore_errors=True)

    def _binaries(self) -> list[Path]:
        machine = subprocess.run(["dpkg", "--print-architecture"], capture_output=True, text=True, check=True)
        return [self.folder / f"dists/sid/main/binary-{kind}" for kind in ("all", machine.stdout.strip())]

    def _gpg(self, *arguments: str) -> bytes:
        command = ["gpg", "--homedir", str(self._gpg_home), "--batch", "--yes", "--passphrase", "", *arguments]
        return subprocess.run(command, capture_output=True, check=True).stdout

    def add(self, name: str, text: str = "one") -> Path:
        tree = self.folder / "build" / name
        (tree / "DEBIAN").mkdir(parents=True, exist_ok=True)
        (tree / "DEBIAN").chmod(0o755)  # dpkg-deb requires it, whatever the umask
        (tree / "DEBIAN/control").write_text(CONTROL.format(name=name))
        (tree / "DEBIAN/postinst").write_text("#!/bin/sh\ntouch /tmp/never-run\n")
        (tree / "DEBIAN/postinst").chmod(0o755)
        (tree / "usr/share").mkdir(parents=True, exist_ok=True)
        (tree / "usr/share" / name).write_text(text)
        deb = self.folder / f"{name}_1.0_all.deb"
        command = ["dpkg-deb", "--root-owner-group", "--build", str(tree), str(deb)]
        subprocess.run(command, check=True, capture_output=True)
        return deb

    def publish(self) -> None:
        """Write lists and their signature."""
        entries = []
        for deb in sorted(self.folder.glob("*.deb")):
            data = deb.read_bytes()
            control = subprocess.run(["dpkg-deb", "--field", str(deb)], capture_output=True, text=True, check=True)
            sums = f"Filename: {deb.name}\nSize: {len(data)}\nSHA256: {hashlib.sha256(data).hexdigest()}\n"
            entries.append(control.stdout + sums)
        packed = "\n".join(entries).encode()
        lines = []
        for place in self._binaries():
            (place / "Packages").write_bytes(packed)
            name = f"main/{place.name}/Packages"
            lines.append(f" {hashlib.sha256(packed).hexdigest()} {len(packed)} {name}\n")
        kinds = " ".join(place.name.removeprefix("binary-") for place in self._binaries())
        release = self.folder / "dists/sid/Release"
        release.write_text(
            f"Suite: sid\nCodename: sid\nArchitectures: {kinds}\nComponents: main\n"
            f"Date: Thu, 01 Jan 2026 00:00:00 UTC\nSHA256:\n{''.join(lines)}"
        )
        self._gpg("--clearsign", "--output", str(release.with_name("InRelease")), str(release))


@pytest.fixture
def repository(tmp_path: Path) -> Iterator[Repository]:
    made = Repository(tmp_path / "repository")
    made.add("alpha")
    made.add("beta")
    made.publish()
    yield made
    made.close()


def fetched(repository: Repository, folder: Path, *names: str):  # type: ignore[no-untyped-def]
    return fetch(names, folder, mirror=f"copy:{repository.folder}", keyring=repository.keyring)


@needs_apt
def test_packages_are_unpacked_into_a_separate_tree(repository: Repository, tmp_path: Path) -> None:
    tree = fetched(repository, tmp_path / "trees", "alpha", "beta")
    assert dict(tree.versions) == {"alpha": "1.0", "beta": "1.0"}
    assert tree.path("usr/share/beta").read_text() == "one"
    assert not Path("/tmp/never-run").exists()
    with pytest.raises(FileNotFoundError, match="gamma"):
        tree.path("usr/share/gamma")


@needs_apt
def test_an_existing_tree_needs_no_repository(repository: Repository, tmp_path: Path) -> None:
    first = fetched(repository, tmp_path / "trees", "alpha")
    shutil.rmtree(repository.folder / "dists")
    assert fetched(repository, tmp_path / "trees", "alpha") == first


@needs_apt
def test_the_remains_of_a_killed_fetch_are_not_taken_for_complete(repository: Repository, tmp_path: Path) -> None:
    root = fetched(repository, tmp_path / "trees", "alpha").root
    (root / "packages.json").unlink()
    (root / "usr/share/alpha").write_text("half")
    aside = root.with_name(f".{root.name}.new")
    aside.mkdir()
    (aside / "rest").touch()
    again = fetched(repository, tmp_path / "trees", "alpha")
    assert again.path("usr/share/alpha").read_text() == "one"
    assert not aside.exists()


@needs_apt
@pytest.mark.parametrize("what", ["package", "list", "key"])
def test_files_that_differ_from_what_was_signed_are_refused(repository: Repository, tmp_path: Path, what: str) -> None:
    if what == "package":
        repository.add("alpha", "another")  # but not published
    elif what == "list":
        release = repository.folder / "dists/sid/InRelease"
        release.write_text(release.read_text().replace("Components: main", "Components:  main"))
    else:
        other = Repository(tmp_path / "other")
        repository.keyring.write_bytes(other.keyring.read_bytes())
        other.close()
    with pytest.raises(PackagesUnavailable, match="apt-get failed"):
        fetched(repository, tmp_path / "trees", "alpha")
    assert [path.name for path in (tmp_path / "trees").iterdir() if path.name.startswith("sid-")] == []


@needs_apt
def test_a_mirror_that_hands_out_no_files_is_no_tree(repository: Repository, tmp_path: Path) -> None:
    with pytest.raises(PackagesUnavailable, match="fetched no package for alpha"):
        fetch(["alpha"], tmp_path / "trees", mirror=repository.folder.as_uri(), keyring=repository.keyring)


@needs_apt
def test_a_package_that_does_not_exist_is_named(repository: Repository, tmp_path: Path) -> None:
    with pytest.raises(PackagesUnavailable, match="gamma"):
        fetched(repository, tmp_path / "trees", "gamma")


@pytest.mark.parametrize("name", ["", "-oDebug=1", "a/b", "A", "a b"])
def test_an_invalid_name_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(PackagesUnavailable, match="not a name of a Debian package"):
        fetch([name], tmp_path)


def test_without_keys_nothing_is_fetched(tmp_path: Path) -> None:
    with pytest.raises(PackagesUnavailable, match="debian-archive-keyring"):
        fetch(["alpha"], tmp_path, mirror="file:///nowhere", keyring=tmp_path / "none.gpg")
