# SPDX-License-Identifier: Apache-2.0
"""The generated tree → bitstreams without a vendor's tool, by yosys, nextpnr and Project X-Ray's database.

`docs/open-flow.md` has a walk-through, and the limits of these tools.
"""
