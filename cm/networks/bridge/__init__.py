# SPDX-License-Identifier: Apache-2.0
"""What every bridge shares: the manager's topics as neutral records, and requests back. No ROS, DDS or zenoh in it.

`records` says what there is; `follower` tells it as it happens; `frames` reads and writes streams; `commands` asks
in the name of a caller. docs/bridges.md is for authors of other bridges.
"""
