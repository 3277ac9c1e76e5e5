# SPDX-License-Identifier: Apache-2.0
"""What the board holds at start, and where to take it."""
