# SPDX-License-Identifier: Apache-2.0
"""Which modules share a region."""
