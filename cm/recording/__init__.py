# SPDX-License-Identifier: Apache-2.0
"""Flight records: what a manager told its clients, kept in MCAP files. `layout` says what is in them."""
