# SPDX-License-Identifier: Apache-2.0
"""What a flow produced → runtime schema, images, overlays, archive."""
