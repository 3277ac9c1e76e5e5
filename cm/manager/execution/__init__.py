# SPDX-License-Identifier: Apache-2.0
"""Changes run one after the other; each step is recorded before it is taken, and failures are rolled back."""
