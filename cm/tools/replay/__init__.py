# SPDX-License-Identifier: Apache-2.0
"""Records, run again: a simulated board gives back what the hardware gave, and the same requests are made again."""
