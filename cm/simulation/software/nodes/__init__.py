# SPDX-License-Identifier: Apache-2.0
"""What the outside sees: device nodes and attributes."""
