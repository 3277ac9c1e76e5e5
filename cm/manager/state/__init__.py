# SPDX-License-Identifier: Apache-2.0
"""The state table, the steps, and their record on disk."""
