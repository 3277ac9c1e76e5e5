# SPDX-License-Identifier: Apache-2.0
"""ed25519 keys in PEM files, as openssl makes them; a key is named after its file.

openssl genpkey -algorithm ed25519 -out release.pem openssl pkey -in release.pem -pubout -out release.pub.pem
"""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cm.formats.signing.errors import SignatureRefused, SigningUnavailable
from cm.formats.signing.manifest import SIGNATURES, read_small

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

_CONTEXT = b"fpga-cm configuration manifest 1\0"  # a signature over something else cannot be used for this
_INSTALL = "install python3-cryptography, or the extra: pip install 'fpga-cm[sign]'"


def key_name(path: Path) -> str:
    """Return a key's name: its file's, without ``.pem`` and ``.pub``."""
    return path.name.removesuffix(".pem").removesuffix(".pub")


def sign(manifest: bytes, keys: list[Path]) -> bytes:
    """Return the signatures of a manifest by private keys. Raises SigningUnavailable, OSError."""
    found = [{"key": key_name(path), "ed25519": _signature(manifest, path)} for path in keys]
    return (json.dumps({"signatures": found}, indent=1) + "\n").encode()


def _signature(manifest: bytes, path: Path) -> str:
    ed25519, serialization = _library()
    try:
        key = serialization.load_pem_private_key(path.read_bytes(), None)
    except (ValueError, TypeError) as problem:
        raise SigningUnavailable(f"{path}: no private key in PEM without a passphrase ({problem})") from problem
    if not isinstance(key, ed25519.Ed25519PrivateKey):
        raise SigningUnavailable(f"{path}: not an ed25519 key: openssl genpkey -algorithm ed25519")
    return base64.b64encode(key.sign(_CONTEXT + manifest)).decode()


def public_keys(folder: Path) -> Mapping[str, Ed25519PublicKey]:
    """Return the keys of a folder's ``*.pem`` by name. Raises SigningUnavailable for all but public ed25519 keys."""
    ed25519, serialization = _library()
    found = {}
    for path in sorted(folder.glob("*.pem")):
        try:
            key = serialization.load_pem_public_key(path.read_bytes())
        except (ValueError, TypeError, OSError) as problem:
            raise SigningUnavailable(f"{path}: no public key in PEM ({problem})") from problem
        if not isinstance(key, ed25519.Ed25519PublicKey):
            raise SigningUnavailable(f"{path}: not an ed25519 key")
        found[key_name(path)] = key
    return found


def signer(folder: Path, manifest: bytes, keys: Mapping[str, Ed25519PublicKey]) -> str:
    """Return which of `keys` has signed a folder's manifest. Raises SignatureRefused if none has."""
    from cryptography.exceptions import InvalidSignature

    claims = _claims(folder)
    for name, signature in claims:
        if name in keys:
            try:
                keys[name].verify(signature, _CONTEXT + manifest)
            except InvalidSignature:
                raise SignatureRefused(f"{folder}: the signature of {name} is not that of this manifest") from None
            return name
    by = ", ".join(name for name, _ in claims)
    known = ", ".join(keys) or "none"
    raise SignatureRefused(f"{folder}: signed by {by}; the keys that are trusted here: {known}")


def _claims(folder: Path) -> list[tuple[str, bytes]]:
    data = read_small(folder / SIGNATURES)
    if data is None:
        raise SignatureRefused(f"{folder}: not signed ({SIGNATURES} is missing)")
    try:
        items = json.loads(data)["signatures"]
        found = [(str(item["key"]), base64.b64decode(item["ed25519"], validate=True)) for item in items]
    except (ValueError, KeyError, TypeError, RecursionError, binascii.Error):
        raise SignatureRefused(f"{folder / SIGNATURES}: no signatures of a manifest") from None
    if not found:
        raise SignatureRefused(f"{folder}: not signed ({SIGNATURES} holds no signature)")
    return found


def _library() -> tuple[Any, Any]:
    try:
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric import ed25519
    except ImportError as problem:
        raise SigningUnavailable(f"signatures need the package cryptography ({problem}): {_INSTALL}") from problem
    return ed25519, serialization
