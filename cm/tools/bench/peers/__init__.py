# SPDX-License-Identifier: Apache-2.0
"""Baselines: two processes that exchange the same bytes by other means."""
