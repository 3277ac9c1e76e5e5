# SPDX-License-Identifier: Apache-2.0
"""What the statuses of a fleet say to people: how each board stands to what is wanted, and how closely clocks agree."""

from __future__ import annotations

from collections.abc import Mapping

from cm.wire.messages.fleet import BoardStatus, ClockSync, FleetState

FINE = ("free", "there")
_OPEN = ("prepared", "changing", "changed", "failing")
_NOTES = {
    "drift": "somebody took it elsewhere, which stays until something new is wanted: `cm fleet reconcile {board}`",
    "local": "it follows nobody (--follow local): `cm fleet mode {mode} {board}` while it is there",
    "behind": "it has seen generation {generation}: the store was set back, and it stays where it is",
    "going": "on its way",
}


def stands_apart(status: BoardStatus) -> bool:
    """Whether a person should look: the board is not where it is wanted, or cannot know."""
    state = status.fleet
    return state is not None and (state.state not in (*FINE, *_OPEN) or bool(state.store_error) or bool(state.error))


def note(board: str, status: BoardStatus) -> str:
    """What is the matter with a board, and what to type; empty if nothing is."""
    state = status.fleet
    if state is None:
        return ""
    said = []
    if state.state in _OPEN:
        said.append(f"change {state.change} to {state.config_name}/{state.mode} is open")
    elif state.state not in FINE:
        text = _NOTES.get(state.state, "").format(board=board, mode=state.wanted_mode, generation=state.generation)
        said.append(f"wanted {wanted(state)} since generation {state.wanted_generation}{f'; {text}' if text else ''}")
    if state.error is not None:
        said.append(state.error.message)
    if state.store_error:
        said.append(f"what is wanted is not known: {state.store_error}")
    return "; ".join(said)


def wanted(state: FleetState | None) -> str:
    """Where a board is wanted; empty if nobody ever wanted anything."""
    return f"{state.wanted_config}/{state.wanted_mode}" if state is not None and state.wanted_generation else ""


def said_apart(clocks: Mapping[str, ClockSync]) -> int | None:
    """How far timestamps of one instant may differ between these boards, ns, as they say themselves.

    None if one of them is not synchronised, or cannot tell. The errors of two boards add up; this holds only if all
    follow the same reference.
    """
    errors = sorted((c.error_ns for c in clocks.values() if c.synchronised and c.error_ns), reverse=True)
    if len(errors) != len(clocks):
        return None
    return sum(errors[:2]) if len(errors) > 1 else 0
