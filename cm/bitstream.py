# SPDX-License-Identifier: Apache-2.0
"""Bitstreams: `cm.formats.bitstream` under its name until 0.1, for one release."""

from cm.formats.bitstream import *  # noqa: F403
