# SPDX-License-Identifier: Apache-2.0
"""Manifests and signatures of configurations: read, or SignatureRefused."""

from __future__ import annotations

import tempfile
from contextlib import suppress
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from cm.formats.signing import (
    MANIFEST,
    SIGNATURES,
    SignatureRefused,
    add_manifest,
    parse,
    public_keys,
    sign,
    signer,
)

PACKAGES = ("cm.formats.signing",)
MAX_LENGTH = 4096

_FOLDER = tempfile.TemporaryDirectory(prefix="cm-fuzz-")
_PLACE = Path(_FOLDER.name)
_KEYS = _PLACE / "keys"


def _key() -> Path:
    key = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
    private = _PLACE / "me.pem"
    private.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    _KEYS.mkdir()
    public = key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    (_KEYS / "me.pem").write_bytes(public)
    return private


_PRIVATE = _key()
_MANIFEST = add_manifest("camera", 3, {"camera.yaml": b"config: {}"})[MANIFEST]


def seeds() -> list[bytes]:
    return [_MANIFEST, sign(_MANIFEST, [_PRIVATE])]


def one(data: bytes) -> None:
    with suppress(SignatureRefused):
        parse(data, Path("m"))
    (_PLACE / SIGNATURES).write_bytes(data)
    with suppress(SignatureRefused):
        assert signer(_PLACE, _MANIFEST, public_keys(_KEYS)) == "me"
