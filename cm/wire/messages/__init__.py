# SPDX-License-Identifier: Apache-2.0
"""Requests, status and events as frozen data: what travels between client, wire, daemon and manager.

Pure data: no protobuf, no sockets, no devices. `cm.wire` turns them into frames and back.
"""
