# SPDX-License-Identifier: Apache-2.0
"""Where the sources are."""

from __future__ import annotations

from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[3]
