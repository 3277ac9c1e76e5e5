# SPDX-License-Identifier: Apache-2.0
"""What travels between a client and the manager, as bytes and as data.

In: protobuf messages (``cm.proto``) and the paper's plain text. Out: frozen requests, status and events (`messages`),
and back. Whoever holds a socket calls `decode` and `encode`; this room knows none, and no device, schema or manager.
"""
