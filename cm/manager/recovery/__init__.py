# SPDX-License-Identifier: Apache-2.0
"""What the board holds at the start, and what mode to bring it to."""
