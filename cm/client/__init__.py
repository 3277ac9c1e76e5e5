# SPDX-License-Identifier: Apache-2.0
"""Clients of the configuration manager: `connect()` and its asyncio twin `aio.connect()`.

`calls` defines requests and what their replies mean; `board` and `aio` only differ in how they wait.
"""
