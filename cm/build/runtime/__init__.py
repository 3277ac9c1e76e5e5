# SPDX-License-Identifier: Apache-2.0
"""The runtime schema of a system."""
