# SPDX-License-Identifier: Apache-2.0
"""What each client has under way at the manager, and how much it may have. Numbers only: no sockets, no requests."""
