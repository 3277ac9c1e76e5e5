# SPDX-License-Identifier: Apache-2.0
"""The static part in Verilog."""
