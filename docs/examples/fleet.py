# SPDX-License-Identifier: Apache-2.0
"""All boards of a fleet to another mode and back: ``CM_FLEET=tcp/router:7447 python fleet.py``."""

from __future__ import annotations

import cm.fleet
from cm.networks.fleet.errors import ChangeFailed, FleetRefused
from cm.wire.messages.fleet import BoardStatus
from cm.wire.messages.status import ErrorInfo


def main() -> None:
    """Look, change all boards together, and go back."""
    with cm.fleet.connect() as fleet:
        for name, status in fleet.status().items():
            print(name, status.status.mode if isinstance(status, BoardStatus) else status.message)
        for name, plan in fleet.plan("edge_detection").items():
            print(name, plan.message if isinstance(plan, ErrorInfo) else f"{plan.bytes} bytes to load")
        try:
            course = fleet.mode("edge_detection")
        except FleetRefused as refused:  # nothing was touched
            for name, error in refused.problems.items():
                print(name, error.message)
            return
        except ChangeFailed as failed:  # the fleet went back, or went on without some boards
            for name, why in failed.course.differing.items():
                print(name, why)
            return
        print(f"{len(course.states)} boards in {course.seconds:.3f} s")
        fleet.mode("default")


if __name__ == "__main__":
    main()
