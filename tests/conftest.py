# SPDX-License-Identifier: Apache-2.0
"""What holds for all tests."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, Phase, settings

# A busy machine must not fail a test: no deadlines. The explain phase costs much and tells little here.
settings.register_profile(
    "cm",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    phases=[Phase.explicit, Phase.reuse, Phase.generate, Phase.shrink],
)
settings.load_profile("cm")

# Nor do simulators that get no processor time; tests of silent ones say their own (seconds).
os.environ.setdefault("CM_SIM_TIMEOUT", "60")
