# SPDX-License-Identifier: Apache-2.0
"""Signed configurations: who made the files of a folder, and whether they are unchanged.

The manifest says which files there are, by sha256, and which version they are; ed25519 keys in PEM files, as openssl
makes them, sign it. A key is named after its file. What is done with configurations without a signature is never read
from the folder that is judged.

openssl genpkey -algorithm ed25519 -out release.pem
openssl pkey -in release.pem -pubout -out release.pub.pem
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cm.errors import CmError
from cm.frozen import dataclass

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

MANIFEST = "manifest.json"
SIGNATURES = "manifest.sig"
_LARGEST = 1 << 20  # bytes of either: thousands of files
_SHA256 = re.compile(r"[0-9a-f]{64}")
_CONTEXT = b"fpga-cm configuration manifest 1\0"  # a signature over something else cannot be used for this
_INSTALL = "install python3-cryptography, or pip install cryptography"
SIGNERS = Path("/etc/cm/signers")


class SignatureRefused(CmError):
    """No signature of a known signer, files other than those that were signed, or an older version."""

    code = "signature_refused"


class SigningUnavailable(CmError):
    """The package that knows ed25519 is not installed, or a key file is not an ed25519 key."""

    code = "signing_unavailable"


@dataclass(frozen=True, slots=True)
class Manifest:
    """`files`: sha256 by name, of all files but the manifest and its signatures. A newer one has a higher `version`."""

    config: str
    version: int
    files: Mapping[str, str]


def add_manifest(config: str, version: int, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return `files` with a manifest of them; the same input gives the same bytes."""
    plain = {name: data for name, data in files.items() if name not in (MANIFEST, SIGNATURES)}
    sums = {name: hashlib.sha256(data).hexdigest() for name, data in sorted(plain.items())}
    text = json.dumps({"config": config, "version": version, "files": sums}, indent=1) + "\n"
    return {**plain, MANIFEST: text.encode()}


def read_small(path: Path) -> bytes | None:
    """Return a file's bytes; None where there is none. Raises SignatureRefused for one that is too long."""
    try:
        with path.open("rb") as file:
            data = file.read(_LARGEST + 1)
    except FileNotFoundError:
        return None
    if len(data) > _LARGEST:
        raise SignatureRefused(f"{path}: over {_LARGEST} bytes")
    return data


def parse(data: bytes, path: Path) -> Manifest:
    """Return what a manifest says. Raises SignatureRefused for what is not a manifest."""
    try:
        found = json.loads(data)
        config, version, files = found["config"], found["version"], found["files"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise SignatureRefused(f"{path}: no manifest of a configuration") from None
    if not isinstance(config, str) or type(version) is not int or version < 0 or not isinstance(files, dict):
        raise SignatureRefused(f"{path}: config must be a name, version a number, files a map")
    for name, sha256 in files.items():
        if Path(name).name != name or not isinstance(sha256, str) or not _SHA256.fullmatch(sha256):
            raise SignatureRefused(f"{path}: {name!r} is not a plain file name with its sha256")
    return Manifest(config, version, files)


def check_files(folder: Path, manifest: Manifest) -> None:
    """Raise SignatureRefused unless the folder holds exactly the files of the manifest."""
    there = {path.name for path in folder.iterdir()} - {MANIFEST, SIGNATURES}
    missing, extra = sorted(manifest.files.keys() - there), sorted(there - manifest.files.keys())
    if missing or extra:
        what = f"{missing[0]} is missing" if missing else f"{extra[0]} was not signed"
        raise SignatureRefused(f"{folder}: {what}")
    for name, sha256 in manifest.files.items():
        if _sha256(folder / name) != sha256:
            raise SignatureRefused(f"{folder / name}: not the file that was signed (sha256)")


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


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


@dataclass(frozen=True, slots=True)
class Policy:
    """`signatures`: ``off`` looks at none, ``warn`` tells, ``require`` refuses. `older`: ``allow`` or ``refuse``.

    `signers`: the folder with the public keys that are trusted.
    """

    signatures: str = "off"
    signers: Path = SIGNERS
    older: str = "allow"


@dataclass(frozen=True, slots=True)
class Judgement:
    """Who signed a folder, and which version it is; `warning`: a sentence to log, if the policy wants one."""

    signer: str | None = None
    version: int | None = None
    warning: str | None = None


def judge(folder: Path, name: str, policy: Policy, installed: Path | None = None) -> Judgement:
    """Judge the files of configuration `name` in `folder`; `installed`: the configuration that they would replace.

    Raises SignatureRefused where the policy requires a signature and the folder has no good one, or
    where it refuses an older version; SigningUnavailable where it requires one and nothing here can
    check it. With ``warn``, a warning says so instead.
    """
    if policy.signatures == "off":
        return Judgement()
    try:
        by, manifest = _signed(folder, name, policy)
        _check_version(folder, manifest, policy, installed)
    except (SignatureRefused, SigningUnavailable) as problem:
        if policy.signatures == "require":
            raise
        return Judgement(warning=str(problem))
    return Judgement(by, manifest.version)


def _signed(folder: Path, name: str, policy: Policy) -> tuple[str, Manifest]:
    data = read_small(folder / MANIFEST)
    if data is None:
        raise SignatureRefused(f"{folder}: not signed ({MANIFEST} is missing)")
    by = signer(folder, data, public_keys(policy.signers))
    manifest = parse(data, folder / MANIFEST)
    if manifest.config != name:
        raise SignatureRefused(f"{folder}: signed for configuration {manifest.config}, not for {name}")
    check_files(folder, manifest)
    return by, manifest


def _check_version(folder: Path, manifest: Manifest, policy: Policy, installed: Path | None) -> None:
    if policy.older != "refuse" or installed is None:
        return
    data = read_small(installed / MANIFEST)
    if data is None:
        return
    before = parse(data, installed / MANIFEST).version
    if manifest.version < before:
        raise SignatureRefused(f"{folder}: version {manifest.version} is older than the one in force, {before}")
