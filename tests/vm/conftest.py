# SPDX-License-Identifier: Apache-2.0
"""The cases run on the board, not on the host."""

collect_ignore = ["cases", "guest"]
