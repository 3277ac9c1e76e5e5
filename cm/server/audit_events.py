# SPDX-License-Identifier: Apache-2.0
"""Who changes what, as an event on ``cm_audit``: the log has it for people, this is for clients that keep it.

Made only while someone subscribes, and behind the reply. The loop's thread.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import lru_cache

from cm.server.publisher import Publisher
from cm.server.rights.admission import Gate
from cm.server.rights.principal import Principal
from cm.server.sender_order import Asked
from cm.wire.encode import encode_audit
from cm.wire.messages.status import Reply


class AuditEvents:
    """Tells of requests that may change something."""

    def __init__(self, publisher: Publisher, gate: Gate) -> None:
        self.publisher = publisher
        self._gate = gate

    def begin(self, asked: Asked) -> Callable[[Reply | None], None]:
        """A request is about to be let through, or refused; what is returned is told its reply.

        None instead: it goes on, and is told again.
        """
        began_ns = time.monotonic_ns()
        by = _named(self._gate.principal(asked.connection))

        def tell(reply: Reply | None) -> None:
            ended_ns = time.monotonic_ns() if reply is not None else 0
            self.publisher.audit(encode_audit(asked.request, *by, (began_ns, ended_ns), reply))

        return tell


@lru_cache(256)
def _named(who: Principal) -> tuple[str, str, int]:
    """As an audit names them."""
    return str(who), who.account, who.pid or 0
