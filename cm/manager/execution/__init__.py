# SPDX-License-Identifier: Apache-2.0
"""Changes run one after the other, each step recorded before it is taken, with a way back."""
