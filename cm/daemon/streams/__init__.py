# SPDX-License-Identifier: Apache-2.0
"""Streams: when they run, their frames, and the ways by which these reach clients."""
