# SPDX-License-Identifier: Apache-2.0
"""Scripts that run inside nextpnr, whose names they use; nothing here imports them."""
