# SPDX-License-Identifier: Apache-2.0
"""Who may send and get what, as zenoh's access control has it. Pure.

What has to be known of it (zenoh 1.10): a rule matches a key expression that it *includes*, so ``cm/a/**`` silently
blocks a query for ``cm/*/status``; every message is checked on its way in and on its way out; reads and commands on
one key cannot be distinguished, so commands have keys of their own, which end with the caller's name; a change of the
rules needs a restart of the router.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from cm.errors import InvalidRequest
from cm.networks.fleet.keeper import OPERATIONS
from cm.networks.fleet.keys import BUNDLES, STORE, VERBS

ROLES = ("observe", "operate", "provision")
_READ = ("status", "config", "reg/**", "irq/**", "frames/**")
ALL_BOARDS = ("*",)


@dataclass(frozen=True, slots=True)
class Member:
    """The holder of a certificate: `kind` is board, client or router.

    `role` and `boards` are a client's.
    """

    name: str
    kind: str
    role: str = "observe"
    boards: tuple[str, ...] = ALL_BOARDS
    keeper: bool = False  # a board that may keep the fleet's wanted state


def verbs_of(role: str) -> tuple[str, ...]:
    """Commands that a role may send. Raises InvalidRequest."""
    if role not in ROLES:
        raise InvalidRequest(
            f"role {role!r}: one of {', '.join(ROLES)} is wanted; an admin's work is done on the board"
        )
    return tuple(name for name, verb in VERBS.items() if ROLES.index(verb.role) <= ROLES.index(role))


def access_control(members: Iterable[Member]) -> dict[str, Any]:
    """The part `access_control` of the router's settings: what is not allowed here is dropped."""
    rules: list[dict[str, Any]] = []
    subjects: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    for member in members:
        if member.kind not in _RULES:  # the router; a cache, of which earlier versions had some
            continue
        made = _RULES[member.kind](member)
        for number, rule in enumerate(made):
            rules.append({"id": f"{member.name}-{number}", "permission": "allow", **rule})
        subjects.append({"id": member.name, "cert_common_names": [member.name]})
        policies.append({"subjects": [member.name], "rules": [f"{member.name}-{n}" for n in range(len(made))]})
    return {
        "enabled": bool(subjects),
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rule(flow: str, messages: Iterable[str], keys: Iterable[str]) -> dict[str, Any]:
    return {"flows": [flow], "messages": list(messages), "key_exprs": list(keys)}


def _board(member: Member) -> list[dict[str, Any]]:
    """Rules for a board: it may speak only under its own name; any query of others for it reaches it.

    It may read the keeper's store, and put its own settings there; and it may be the keeper.
    """
    own, store = f"cm/{member.name}/**", [f"{STORE}/{operation}/{member.name}" for operation in ("get", "join")]
    return [
        _rule("ingress", ("put", "declare_queryable", "reply", "liveliness_token"), [own]),
        _rule("ingress", ("query",), [*store, f"{BUNDLES}/**"]),
        _rule("ingress", ("liveliness_query",), [f"cm/{member.name}/alive"]),
        _rule("egress", ("query", "declare_subscriber"), ["cm/**"]),
        _rule("egress", ("reply", "declare_queryable"), [*store, "cm/*/**", f"{BUNDLES}/**"]),
        _rule("egress", ("liveliness_token",), [f"cm/{member.name}/alive"]),
        *_follows_store(f"boards/{member.name}/**"),
        *(_keeper() if member.keeper else ()),
    ]


def _keeper() -> list[dict[str, Any]]:
    """Whoever keeps the store answers for it, and tells what has changed."""
    offered, alive = [f"{STORE}/*/*"], [f"{STORE}/alive"]
    return [
        _rule("ingress", ("declare_queryable", "reply"), offered),
        _rule("ingress", ("put",), [f"{STORE}/changed/**"]),
        _rule("ingress", ("liveliness_token", "liveliness_query"), alive),
        _rule("egress", ("query",), offered),
        _rule("egress", ("declare_subscriber",), [f"{STORE}/**"]),
    ]


def _follows_store(what: str) -> list[dict[str, Any]]:
    """Being told of changes in it, and whether its keeper is there."""
    changed, alive = [f"{STORE}/changed/{what}"], [f"{STORE}/alive"]
    return [
        _rule("ingress", ("declare_subscriber",), changed),
        _rule("ingress", ("declare_liveliness_subscriber", "liveliness_query"), alive),
        _rule("egress", ("put",), changed),
        _rule("egress", ("liveliness_token",), alive),
        _rule("egress", ("declare_queryable",), [f"{STORE}/**"]),
    ]


def _client(member: Member) -> list[dict[str, Any]]:
    read = [f"cm/{board}/{part}" for board in member.boards for part in _READ]
    commands = [f"cm/{b}/do/{verb}/{member.name}" for b in member.boards for verb in verbs_of(member.role)]
    alive = [f"cm/{board}/alive" for board in member.boards]
    seen = [f"cm/{board}/**" for board in member.boards]
    # A transaction may be about any boards: who is limited to some may read the store, and write nothing there.
    writes = member.role != "observe" and member.boards == ALL_BOARDS
    commands += [f"{STORE}/{each}/{member.name}" for each in (OPERATIONS if writes else OPERATIONS[:1])]
    # Tokens are queried with one expression, which has to be allowed as a whole; they reveal only names.
    found = [
        _rule("ingress", ("query",), [*read, *commands]),
        _rule("ingress", ("declare_subscriber",), read),
        _rule("ingress", ("liveliness_query", "declare_liveliness_subscriber"), ["cm/*/alive", *alive]),
        _rule("egress", ("put", "reply"), [*read, *commands]),
        _rule("egress", ("declare_queryable",), seen),
        _rule("egress", ("liveliness_token",), ["cm/*/alive"]),
        *_follows_store("boards/**"),
    ]
    if member.role == "provision":
        found.append(_rule("ingress", ("declare_queryable", "reply"), [f"{BUNDLES}/origin/**"]))
        found.append(_rule("egress", ("query",), [f"{BUNDLES}/**"]))
    return found


_RULES = {"board": _board, "client": _client}
