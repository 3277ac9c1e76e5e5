# SPDX-License-Identifier: Apache-2.0
"""Why a signed configuration is refused, or cannot be told from an unsigned one."""

from __future__ import annotations

from cm.errors import CmError


class SignatureRefused(CmError):
    """No signature of a known signer, files other than those that were signed, or an older version."""

    code = "signature_refused"


class SigningUnavailable(CmError):
    """The package that knows ed25519 is not installed, or a key file is not an ed25519 key."""

    code = "signing_unavailable"
