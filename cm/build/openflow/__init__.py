# SPDX-License-Identifier: Apache-2.0
"""From the generated tree to bitstreams without a vendor's tool: yosys, nextpnr, Project X-Ray's database.

`docs/open-flow.md` has the walk-through, and what the tools lack.
"""
