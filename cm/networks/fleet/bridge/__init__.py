# SPDX-License-Identifier: Apache-2.0
"""``cm bridge fleet``: a process beside a board's manager, which makes the board part of a fleet."""
