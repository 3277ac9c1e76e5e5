# SPDX-License-Identifier: Apache-2.0
"""What is done with configurations without a signature. The policy is never read from the folder that it judges."""

from __future__ import annotations

from pathlib import Path

from cm.formats.signing.errors import SignatureRefused, SigningUnavailable
from cm.formats.signing.keys import public_keys, signer
from cm.formats.signing.manifest import MANIFEST, Manifest, check_files, parse, read_small
from cm.frozen import dataclass

SIGNERS = Path("/etc/cm/signers")


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
