# SPDX-License-Identifier: Apache-2.0
"""Certificates of a fleet, and the router's rules that go with them."""
