# SPDX-License-Identifier: Apache-2.0
"""Makes the runtime schema of a system."""
