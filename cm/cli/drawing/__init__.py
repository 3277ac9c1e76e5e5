# SPDX-License-Identifier: Apache-2.0
"""Frames as pictures: what can be seen of an array, drawn in a terminal or a window."""
