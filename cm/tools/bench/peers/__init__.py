# SPDX-License-Identifier: Apache-2.0
"""Baselines: two processes that exchange the same bytes by other means.

In each module ``near(folder, size)`` is the end in the measuring process: ``trip()`` goes there and back, ``close()``
releases what it holds. ``far(folder, size, ready)`` serves until it is killed, and calls `ready` once it listens.
"""
