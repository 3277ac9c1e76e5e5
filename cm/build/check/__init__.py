# SPDX-License-Identifier: Apache-2.0
"""What stands in for Vivado: rules that a design must keep, each with the message that Vivado has for it."""
