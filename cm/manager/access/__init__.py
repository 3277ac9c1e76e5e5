# SPDX-License-Identifier: Apache-2.0
"""Registers and memories by name, the bus below both, and who may use them."""
