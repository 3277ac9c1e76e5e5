# SPDX-License-Identifier: Apache-2.0
"""Statuses and plans as people see them: in a terminal, and in notebooks."""

from __future__ import annotations

from typing import Any


def place(config: str, mode: str | None) -> str:
    """A mode of a configuration for people, or that it is in none."""
    return f"{config}/{mode or 'no mode'}"


class StatusText:
    """Of `cm.wire.messages.status.Status`."""

    __slots__ = ()

    def __str__(self: Any) -> str:
        """What people look for first, in a few lines."""
        loaded = place(self.config_name, self.mode) if self.config_name else "nothing loaded"
        goes_on = f", {self.progress.step} {self.progress.subject}".rstrip() if self.progress is not None else ""
        lines = [f"{self.board or 'board'}: {loaded}, {self.pr_mode.value}{goes_on}"]
        if self.last_error is not None:
            lines.append(f"last error: {self.last_error.message} [{self.last_error.code}]")
        if self.regions:
            lines.append("regions: " + ", ".join(f"{r.name} {r.module or '-'} ({r.state})" for r in self.regions))
        flowing = ", ".join(f"{s.name} {s.rate:.1f}/s" if s.open else f"{s.name} closed" for s in self.streams)
        return "\n".join([*lines, *([f"streams: {flowing}"] if flowing else [])])

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:  # noqa: ARG002 (IPython's)
        printer.text(str(self))

    def _repr_html_(self) -> str:
        from cm.wire.messages import notebook  # only notebooks need it

        return notebook.status(self)


class PlanText:
    """Of `cm.wire.messages.status.PlanInfo`."""

    __slots__ = ()

    def __str__(self: Any) -> str:
        """A line for each step."""
        steps = [f"{i:2} {s.text}{f' ({s.bytes} bytes)' if s.bytes else ''}" for i, s in enumerate(self.steps, 1)]
        total = f"{self.bytes} bytes to load, about {self.seconds * 1000:.1f} ms" if steps else "nothing to do"
        return "\n".join([*steps, f"{place(self.config_name, self.mode)}: {total}"])

    def _repr_html_(self) -> str:
        from cm.wire.messages import notebook

        return notebook.plan(self)
