# SPDX-License-Identifier: Apache-2.0
"""Rules that a design must keep, in place of Vivado, each with Vivado's message for it."""
