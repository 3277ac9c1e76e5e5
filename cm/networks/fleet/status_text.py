# SPDX-License-Identifier: Apache-2.0
"""What the statuses of a fleet say to people: how each board stands to what is wanted."""

from __future__ import annotations

from cm.wire.messages.fleet import BoardStatus, FleetState

FINE = ("free", "there")
_OPEN = ("prepared", "changing", "changed", "failing")
_NOTES = {
    "drift": "somebody took it elsewhere, which stays until something new is wanted: `cm fleet reconcile {board}`",
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
