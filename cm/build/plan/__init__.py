# SPDX-License-Identifier: Apache-2.0
"""Project and boundaries → the system that is generated."""
