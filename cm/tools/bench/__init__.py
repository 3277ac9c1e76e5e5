# SPDX-License-Identifier: Apache-2.0
"""Measurements beside the alternatives, in one run (docs/performance.md)."""
