# SPDX-License-Identifier: Apache-2.0
"""What a fleet's boards say for a while: ``CM_FLEET=tcp/router:7447 python fleet_asyncio.py``."""

from __future__ import annotations

import asyncio

import cm.fleet


async def main(statuses: int = 3) -> None:
    """Follow all boards, and write a register of each."""
    async with cm.fleet.aio.connect() as fleet:
        first, *_ = await fleet.boards()
        frame = await fleet.frame(first, "camera")
        print(first, frame.shape)
        for name, written in (await fleet.write({"led": 1})).items():
            print(name, written)
        async with fleet.watch() as watched:
            async for name, status in watched:
                print(name, "gone" if status is None else status.status.mode)
                statuses -= 1
                if not statuses:
                    return


if __name__ == "__main__":
    asyncio.run(main())
