# SPDX-License-Identifier: Apache-2.0
"""Clients of the configuration manager: `connect()` and its asyncio twin `aio.connect()`.

`calls` says what to ask and what an answer means; `board` and `aio` only differ in how they wait.
"""
