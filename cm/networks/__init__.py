# SPDX-License-Identifier: Apache-2.0
"""A manager in other people's networks: many boards together over zenoh, and a board as a ROS 2 node.

In: what a client of one manager sees. Out: the same in that network's terms, and its requests back, in the name of
whoever made them. It must not know the manager, its server or devices: each bridge is a client with no more rights
than it is given.
"""
