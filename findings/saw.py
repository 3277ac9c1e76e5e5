# SPDX-License-Identifier: Apache-2.0
"""What a script has seen, beside what was seen before: other behaviour ends it with status 1."""

import sys


def saw(what: str, value: object, before: object) -> None:
    print(f"{what}: {value!r}")
    if value != before:
        sys.exit(f"this has changed: it was {before!r}")
