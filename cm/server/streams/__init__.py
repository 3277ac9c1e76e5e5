# SPDX-License-Identifier: Apache-2.0
"""Streams: when they run, and how their frames reach clients."""
