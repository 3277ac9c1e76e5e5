# SPDX-License-Identifier: Apache-2.0
"""Who may send and get what, as zenoh's access control has it. Pure.

What has to be known of it (zenoh 1.10): a rule matches a key expression that it *includes*, so ``cm/a/**`` silently
blocks a query for ``cm/*/status``; every message is checked on its way in and on its way out; reads and commands on
one key cannot be distinguished, so commands have keys of their own, which end with the caller's name; a change of the
rules needs a restart of the router.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from cm.errors import InvalidRequest
from cm.networks.fleet.keeper import OPERATIONS
from cm.networks.fleet.keys import BUNDLES, STORE, VERBS

ROLES = ("observe", "operate", "provision")
_READ = ("status", "config", "reg/**", "irq/**", "frames/**")
ALL_BOARDS = ("*",)
_Rule = tuple[str, str, Sequence[str]]  # flow, messages, keys


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
    made = {m.name: _RULES[m.kind](m) for m in members}
    return {
        "enabled": bool(made),
        "default_permission": "deny",
        "rules": [
            {
                "id": f"{name}-{number}", "permission": "allow", "flows": [flow], "messages": messages.split(),
                "key_exprs": list(keys),
            }
            for name, rules in made.items()
            for number, (flow, messages, keys) in enumerate(rules)
        ],
        "subjects": [{"id": name, "cert_common_names": [name]} for name in made],
        "policies": [
            {"subjects": [name], "rules": [f"{name}-{number}" for number in range(len(rules))]}
            for name, rules in made.items()
        ],
    }  # fmt: skip


def _board(member: Member) -> list[_Rule]:
    """Rules for a board: it may speak only under its own name; any query of others for it reaches it.

    It may read the keeper's store, and put its own settings there; and it may be the keeper.
    """
    alive, store = [f"cm/{member.name}/alive"], [f"{STORE}/{operation}/{member.name}" for operation in ("get", "join")]
    return [
        ("ingress", "put declare_queryable reply liveliness_token", [f"cm/{member.name}/**"]),
        ("ingress", "query", [*store, *alive, f"{BUNDLES}/**"]),  # it asks itself whether it is heard
        ("ingress", "liveliness_query", alive),
        ("egress", "query declare_subscriber", ["cm/**"]),
        ("egress", "reply declare_queryable", [*store, "cm/*/**", f"{BUNDLES}/**"]),
        ("egress", "liveliness_token", alive),
        *_follows_store(f"boards/{member.name}/**"),
        *(_KEEPER if member.keeper else ()),
    ]


_KEEPER: tuple[_Rule, ...] = (  # whoever keeps the store answers for it, and tells what has changed
    ("ingress", "declare_queryable reply", [f"{STORE}/*/*"]),
    ("ingress", "put", [f"{STORE}/changed/**"]),
    ("ingress", "liveliness_token liveliness_query", [f"{STORE}/alive"]),
    ("egress", "query", [f"{STORE}/*/*"]),
    ("egress", "declare_subscriber", [f"{STORE}/**"]),
)


def _follows_store(what: str) -> list[_Rule]:
    """Being told of changes in it, and whether its keeper is there."""
    changed, alive = [f"{STORE}/changed/{what}"], [f"{STORE}/alive"]
    return [
        ("ingress", "declare_subscriber", changed),
        ("ingress", "declare_liveliness_subscriber liveliness_query", alive),
        ("egress", "put", changed),
        ("egress", "liveliness_token", alive),
        ("egress", "declare_queryable", [f"{STORE}/**"]),
    ]


def _client(member: Member) -> list[_Rule]:
    read = [f"cm/{board}/{part}" for board in member.boards for part in _READ]
    commands = [f"cm/{b}/do/{verb}/{member.name}" for b in member.boards for verb in verbs_of(member.role)]
    # A transaction may be about any boards: who is limited to some may read the store, and write nothing there.
    writes = member.role != "observe" and member.boards == ALL_BOARDS
    commands += [f"{STORE}/{each}/{member.name}" for each in (OPERATIONS if writes else OPERATIONS[:1])]
    # Tokens are queried with one expression, which has to be allowed as a whole; they reveal only names.
    alive = ["cm/*/alive", *(f"cm/{board}/alive" for board in member.boards)]
    found: list[_Rule] = [
        ("ingress", "query", [*read, *commands]),
        ("ingress", "declare_subscriber", read),
        ("ingress", "liveliness_query declare_liveliness_subscriber", alive),
        ("egress", "put reply", [*read, *commands]),
        ("egress", "declare_queryable", [f"cm/{board}/**" for board in member.boards]),
        ("egress", "liveliness_token", ["cm/*/alive"]),
        *_follows_store("boards/**"),
    ]
    if member.role == "provision":
        found.append(("ingress", "declare_queryable reply", [f"{BUNDLES}/origin/**"]))
        found.append(("egress", "query", [f"{BUNDLES}/**"]))
    return found


_RULES = {"board": _board, "client": _client}
