# SPDX-License-Identifier: Apache-2.0
"""Clients of the manager: `connect()` gives a `Board`, `aio.connect()` its asyncio twin.

In: calls in Python's terms. Out: requests over `cm.wire`, and frames that stay in DMA memory. `core` holds what both
clients do, without sockets; the two differ in how they wait. They must not know the manager or devices.
"""
