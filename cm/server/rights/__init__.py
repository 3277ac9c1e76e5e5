# SPDX-License-Identifier: Apache-2.0
"""Who may do what: one policy for every kind of connection. Data and functions only; docs/security.md has the table."""
