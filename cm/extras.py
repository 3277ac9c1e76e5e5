# SPDX-License-Identifier: Apache-2.0
"""What an extra of the package brings, for messages about what is missing."""

from __future__ import annotations


def installing(extra: str) -> str:
    """A command that installs it: its packages by name, as an index need not have this one."""
    from importlib.metadata import PackageNotFoundError, requires  # only for a message

    mark = f'extra == "{extra}"'
    try:
        rows = [row for row in requires("fpga-cm") or () if mark in row.replace("'", '"')]
    except PackageNotFoundError:
        rows = []
    names = [f"'{row.partition(';')[0].strip()}'" for row in rows]
    return f"pip install {' '.join(names)}" if names else f"pip install 'fpga-cm[{extra}]'"
