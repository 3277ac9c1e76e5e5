# SPDX-License-Identifier: Apache-2.0
"""The build schema as data."""
