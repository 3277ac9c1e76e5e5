# SPDX-License-Identifier: Apache-2.0
"""Settings of Cyclone DDS that keep to this machine's loopback: for measurements, demonstrations and tests."""

from __future__ import annotations

from cm.dds import config

_SETTINGS = """<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>
<AllowMulticast>false</AllowMulticast><MaxMessageSize>65500B</MaxMessageSize><FragmentSize>65000B</FragmentSize></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>20</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery>
<Internal>{buffer}<Watermarks><WhcHigh>16MB</WhcHigh></Watermarks></Internal></Domain></CycloneDDS>"""


def loopback() -> str:
    """For CYCLONEDDS_URI."""
    return _SETTINGS.format(buffer=config.MINIMUM if config.lets_buffers_be_large() else "")
