# SPDX-License-Identifier: Apache-2.0
"""Archives that the fleet sends: fetched piece by piece, checked, and put in force as ``cm import archive`` does it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm.client.core import calls
from cm.client.errors import RequestNotFound
from cm.errors import CmError
from cm.networks.fleet.bridge.managed_board import ManagedBoard
from cm.networks.fleet.bundles import fetched
from cm.wire.messages.fleet import BundleState, FetchBundle
from cm.wire.messages.status import ErrorInfo

Import = Callable[[Path], tuple[str, str]]  # the archive → configuration, its signer (empty: none)
_NO_CONFIG = "."  # no configuration has this name, so asking whether one may remove it changes nothing


class NoBundles(CmError):
    """This bridge takes no archives."""

    code = "unsupported"


@dataclass
class Bundles:
    """The archives of one board. `take` is None if it accepts none."""

    session: Any
    folder: Path
    take: Import | None
    managed: ManagedBoard
    busy: Callable[[], bool]  # while a change of the fleet is open here, which goes first

    async def fetch(self, bundle: FetchBundle, caller: str) -> BundleState:
        """Fetch an archive and put it in force; if it cannot be had now, returns how much has arrived.

        Raises a refusal.
        """
        if self.take is None:
            raise NoBundles("this board's bridge takes no archives: start it with --import-to DIR")
        with contextlib.suppress(RequestNotFound):  # raises RequestForbidden, if the manager's policy does not let it
            await self.managed.relay.ask(calls.remove_config(_NO_CONFIG, ""), self.managed.guest(caller))
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        archive = self.folder / f"{bundle.sha256}.tar"
        try:
            config, signer = await asyncio.to_thread(self._taken, self.take, bundle, archive)
        except (CmError, OSError) as error:  # a full disk, too
            have = archive.stat().st_size if archive.exists() else 0
            code = error.code if isinstance(error, CmError) else "io"
            return BundleState(bundle.sha256, bundle.length, have, error=ErrorInfo(code, str(error)))
        return BundleState(bundle.sha256, bundle.length, bundle.length, config, signer)

    def _taken(self, take: Import, bundle: FetchBundle, archive: Path) -> tuple[str, str]:
        fetched(self.session, bundle, archive, busy=self.busy)
        try:
            return take(archive)
        finally:
            archive.unlink()
