# SPDX-License-Identifier: Apache-2.0
"""A region's common boundary: the union of its modules' interfaces, and how each module is fitted to it.

boundary(modules) -> Boundary
"""
