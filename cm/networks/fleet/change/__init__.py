# SPDX-License-Identifier: Apache-2.0
"""A change of many boards as one transaction: what each side does next, without sockets, files or clocks."""
