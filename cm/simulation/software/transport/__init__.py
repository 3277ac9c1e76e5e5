# SPDX-License-Identifier: Apache-2.0
"""The node protocol; no device in it."""
