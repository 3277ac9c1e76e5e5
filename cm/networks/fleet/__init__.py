# SPDX-License-Identifier: Apache-2.0
"""Many boards over zenoh: the bridges that `cm bridge fleet` starts beside their managers, and the client of them."""
