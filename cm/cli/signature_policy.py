# SPDX-License-Identifier: Apache-2.0
"""The policy of the settings, applied to configurations that are imported or served."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from cm.formats.signing import Policy, SignatureRefused, SigningUnavailable, judge
from cm.schema.model import Config
from cm.server.settings.model import Settings


def policy_of(settings: Settings | None) -> Policy:
    """What the settings say about signatures; without settings they are ignored."""
    if settings is None:
        return Policy()
    said = settings.policy
    return Policy(said.signatures, said.signers, said.older)


def signed_only(configs: Mapping[str, Config], policy: Policy) -> tuple[dict[str, Config], tuple[str, ...]]:
    """Return the configurations that the policy accepts, and a sentence for each refused or doubtful one."""
    kept, sentences = {}, []
    for name, config in configs.items():
        try:
            found = judge(_folder(config), name, policy)
        except (SignatureRefused, SigningUnavailable) as problem:
            sentences.append(f"configuration {name} is left out: {problem}")
            continue
        kept[name] = config
        if found.warning:
            sentences.append(f"configuration {name}: {found.warning}")
    return kept, tuple(sentences)


def _folder(config: Config) -> Path:
    return config.source.parent if config.source else Path()
