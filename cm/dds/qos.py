# SPDX-License-Identifier: Apache-2.0
"""Quality of service as ROS's RMW over Cyclone DDS sets it."""

from __future__ import annotations

from cyclonedds.core import Policy
from cyclonedds.core import Qos as DdsQos
from cyclonedds.util import duration

from cm.ros.transport import Qos

_BLOCKED = duration(milliseconds=100)  # how long a full queue of a slow reader may hold a writer up
_ANY = -1


def qos(wanted: Qos, hash_text: str, more: str = "") -> DdsQos:
    """Quality of service with the type's hash in USER_DATA, after `more`, where ROS's tools look for it."""
    history = Policy.History.KeepLast(wanted.depth)
    policies = [
        Policy.Reliability.Reliable(_BLOCKED) if wanted.reliable else Policy.Reliability.BestEffort,
        history,
        Policy.Userdata(f"{more}typehash={hash_text};".encode()),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    ]
    if wanted.latched:
        policies.append(Policy.Durability.TransientLocal)
        policies.append(Policy.DurabilityService(0, history, _ANY, _ANY, _ANY))
    return DdsQos(*policies)
