# SPDX-License-Identifier: Apache-2.0
"""The generated flow, run by make."""
