# SPDX-License-Identifier: Apache-2.0
"""The process `cm serve`: sockets, who may do what, and what clients are told.

In: frames from ZeroMQ and from the data plane's socket, settings. Out: calls of the manager in one thread, replies,
publications, frames. It must not know protobuf (`cm.wire` does), nor how a board is changed (`cm.manager` does).
"""
