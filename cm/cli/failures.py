# SPDX-License-Identifier: Apache-2.0
"""What went wrong, said: a code and a sentence."""

from __future__ import annotations

import sys

from cm.cli.colours import painted
from cm.errors import CmError


def code_and_sentence(error: CmError | OSError) -> tuple[str, str]:
    """As ``--json`` has them; the code is `io` for what the system refused."""
    if isinstance(error, CmError):
        return error.code, str(error)
    reason = error.strerror or str(error)
    return "io", f"{error.filename}: {reason}" if error.filename else reason


def tell(code: str, message: str) -> None:
    """Tell people, on standard error."""
    named = "" if code == "io" else painted(f" [{code}]", "dim", sys.stderr)
    print(f"{painted('cm:', 'red', sys.stderr)} {message}{named}", file=sys.stderr)
