# SPDX-License-Identifier: Apache-2.0
"""Hashes are those of hashlib, whoever computes them, and OpenSSL comes in where there is much to hash."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from importlib.util import find_spec

import pytest

LENGTHS = (0, 1, 63, 64, (1 << 16) - 1, 1 << 16, (1 << 16) + 1, 1 << 20, (1 << 20) + 1)
HASHES = """
import sys
from cm.hashes import sha256

for length in map(int, sys.argv[1:]):
    data = bytes(number % 251 for number in range(length))
    print(sha256(data), sha256(memoryview(data)), "hashlib" in sys.modules)
"""
has_its_own = pytest.mark.skipif(
    not (find_spec("_sha2") or find_spec("_sha256")), reason="this Python has no SHA-256 but OpenSSL's"
)


def hashed(before: str, *lengths: int) -> list[list[str]]:
    """What a new interpreter says of so many bytes: the hash of them, and of a view; whether it has hashlib."""
    command = [sys.executable, "-c", before + HASHES, *map(str, lengths)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return [line.split() for line in done.stdout.splitlines()]


@pytest.mark.parametrize(
    "before",
    ["", "import hashlib", "import sys; sys.modules.update(_sha2=None, _sha256=None)"],
    ids=["own", "hashlib", "none"],
)
def test_a_hash_is_that_of_hashlib(before: str) -> None:
    for length, (of_bytes, of_view, _) in zip(LENGTHS, hashed(before, *LENGTHS), strict=True):
        expected = hashlib.sha256(bytes(number % 251 for number in range(length))).hexdigest()
        assert (of_bytes, of_view) == (expected, expected), length


@has_its_own
def test_openssl_comes_in_where_there_is_much_to_hash() -> None:
    assert [found[2] for found in hashed("", 0, 1 << 20, (1 << 20) + 1)] == ["False", "False", "True"]
