# SPDX-License-Identifier: Apache-2.0
"""The simulated board as a process: started, controlled, ended."""
