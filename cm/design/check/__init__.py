# SPDX-License-Identifier: Apache-2.0
"""Checks that a design must pass, made here instead of in Vivado; each names the message that Vivado would give."""
