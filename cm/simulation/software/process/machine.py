# SPDX-License-Identifier: Apache-2.0
"""The whole board: hardware derived from a `BoardSpec`, served under a root."""

from __future__ import annotations

import os
import sys
import uuid

from cm.frozen import replace
from cm.loop import Loop
from cm.schema.model import LoaderKind
from cm.simulation.software.errors import SimError
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.board_spec import BoardSpec, ChannelSpec
from cm.simulation.software.hardware.configuration_engine import ConfigurationEngine
from cm.simulation.software.hardware.configuration_memory import ConfigMemory, digest
from cm.simulation.software.hardware.dma import Channel
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.logic import LogicParts, MakeLogic, Options, SoftwareLogic
from cm.simulation.software.hardware.models import Models
from cm.simulation.software.nodes import uio
from cm.simulation.software.nodes.clocks import Clocks
from cm.simulation.software.nodes.dma import DmaNode
from cm.simulation.software.nodes.fpga_manager import FpgaManager
from cm.simulation.software.nodes.gpio import GpioChipNode
from cm.simulation.software.nodes.icap import IcapNode
from cm.simulation.software.nodes.overlays import Overlays
from cm.simulation.software.nodes.sensors import serve_sensors
from cm.simulation.software.nodes.window import WindowNode
from cm.simulation.software.process.firmware import Firmware
from cm.simulation.software.transport.buffers import DmaMemory
from cm.simulation.software.transport.root import Root
from cm.simulation.software.transport.server import Server

ICAP_CLOCK = {"7series": 100_000_000, "ultrascale+": 200_000_000}


class Machine:
    """A running board."""

    def __init__(
        self, loop: Loop, root: Root, spec: BoardSpec, models: Models, options: Options, make: MakeLogic = SoftwareLogic
    ) -> None:
        self.loop, self.root, self.spec, self.options = loop, root, spec, options
        self.server = Server(loop)
        self.faults = Faults()
        self.fabric = Fabric(spec)
        self.memory = DmaMemory(options.memory, options.coherent)
        self.logic = make(LogicParts(loop, self.fabric, self.faults, models, self.memory, options))
        self.engine = self._engine()
        self.manager = FpgaManager(root, self.engine, self.faults, options.pcap_rate)
        self.overlays = Overlays(root, self.manager, self.faults)
        self.clocks = Clocks(root, _clock_names(spec), spec.device.family.label, self.faults)
        self.channels = {name: Channel(channel) for name, channel in _with_engines(spec, options).items()}
        self.links = self.logic.links(self.channels)
        self.dma_nodes = {name: DmaNode(channel, self.memory) for name, channel in self.channels.items()}
        self.icap_node = self._icap_node()
        self._upsets: list[tuple[int, int]] = []  # the last: frame address, and bit of the frame
        self.faults.loads = lambda: self.engine.loads - self.engine.reads
        self.fabric.changed = self.faults.ordered = self.kick

    def serve(self) -> None:
        """Make the nodes; from now on clients can come."""
        self.root.write("proc/sys/kernel/random/boot_id", f"{uuid.uuid4()}\n")
        for index, window in enumerate(self.fabric.windows):
            uio.write_sysfs(self.root, index, window)
            node = uio.UioNode(window, self.logic.interrupts.lines[index], self.logic.bus)
            self.server.listen(self.root.bind(f"dev/uio{index}"), node)
        if isinstance(self.logic, SoftwareLogic):  # other logic has to see each access
            self.server.listen(self.root.bind("dev/cm_window"), WindowNode(self.fabric, self.logic.bus, self.server))
        for name, dma_node in self.dma_nodes.items():
            self.server.listen(self.root.bind(f"dev/cm_dma/{name}"), dma_node)
        for name in _icap_names(self.spec):
            self.server.listen(self.root.bind(f"dev/{name}"), self.icap_node)
        serve_sensors(self.root, self.spec.device.family.label)
        self.manager.serve(self.server)
        self.overlays.serve(self.server)
        self.clocks.serve(self.server)
        for chip in self.fabric.lines.chips:
            self.server.listen(
                self.root.bind(f"dev/{chip.name}"), GpioChipNode(chip, self.fabric, self.faults, self.server)
            )

    def upset(self, region: str, bits: int, frame: int | None, bit: int | None) -> None:
        """Turn over bits of a region's frames. Raises KeyError where it holds none."""
        self._upsets = self._config.hit(region, bits, frame, bit)

    def power_up(self) -> None:
        """Empty all, as power-up does."""
        self._config.frames.clear()
        self.fabric.reset()
        for line in self.logic.interrupts.lines:
            line.drop_pending()
        self.kick()

    def kick(self) -> None:
        """Let every link check whether data can move."""
        for link in self.links.values():
            link.kick()

    def close(self) -> None:
        """End all connections."""
        self.server.close()
        for link in self.links.values():
            link.close()
        self.logic.close()

    def state(self) -> dict[str, object]:
        """What the board holds now, for tests and people."""
        self.kick()  # nothing is lent while we read the state
        return {
            "pid": os.getpid(),
            "arguments": sys.argv[1:],
            "regions": {
                name: {
                    "module": region.module.name if region.module else None,
                    "loading": region.loading,
                    "decoupled": region.decoupled,
                }
                for name, region in self.fabric.regions.items()
            },
            "channels": {name: self._channel_state(name) for name in self.channels},
            "interrupts": {f"uio{index}": line.count for index, line in enumerate(self.logic.interrupts.lines)},
            "connections": self.server.connections,
            "buffers": self._buffers(),
            "memory": self.memory.used,
            "syncs": self._syncs(),
            "loads": self.engine.loads,
            "loading": self.engine.busy,
            "outside_writes": self._config.outside,
            "overlays": self.overlays.applied,
            "clocks": self.clocks.rates,
            "upsets": self._upsets,
            "faults": self.faults.listing(),
            **self.logic.state(),
        }

    def _buffers(self) -> int:
        channels = sum(len(session.buffers) for node in self.dma_nodes.values() for session in node.sessions)
        return channels + sum(len(session.buffers) for session in self.icap_node.sessions)

    def _syncs(self) -> dict[str, dict[str, int]]:
        """The counts of synchronisations, if they are needed."""
        if self.memory.coherent:
            return {}
        channels = {name: node.syncs.totals() for name, node in self.dma_nodes.items()}
        return {**channels, "icap": self.icap_node.syncs.totals()}

    def _channel_state(self, name: str) -> dict[str, object]:
        channel, link = self.channels[name], self.links[name]
        state: dict[str, object] = {
            "open": channel.completions is not None,
            "queued": len(channel.queue),
            "bytes": channel.moved,
            "lent": link.lent,
        }
        if link.camera is not None:
            state |= {"frames": link.camera.frames, "photo": link.camera.photo}
        return state

    def _engine(self) -> ConfigurationEngine:
        firmware = Firmware(self.root, self.spec)
        known = firmware.install()
        self.logic.know(firmware.images(), digest)
        self._config = ConfigMemory(self.fabric, known)
        rate = self.options.icap_rate
        if rate is None:
            rate = 4.0 * ICAP_CLOCK[self.spec.device.family.label]
        return ConfigurationEngine(self.loop, self.fabric, self._config, self.faults, self.spec.device, rate)

    def _icap_node(self) -> IcapNode:
        device = self.spec.device
        clock = ICAP_CLOCK[device.family.label]
        return IcapNode(self.engine, self.logic.configure, self.memory, device.idcode, clock, self.faults)


def _with_engines(spec: BoardSpec, options: Options) -> dict[str, ChannelSpec]:
    for name in (*options.vdma, *options.simple):
        if name not in spec.channels:
            raise SimError(f"no channel is called {name}; there are {', '.join(sorted(spec.channels))}")
        if name in options.vdma and name in options.simple:
            raise SimError(f"channel {name} is a VDMA's or has a length register, not both")
    return {
        name: replace(channel, vdma=name in options.vdma, simple=bits, blind=blind)
        for name, channel in spec.channels.items()
        for bits, blind in [options.simple.get(name, (0, False))]
    }


def _clock_names(spec: BoardSpec) -> set[str]:
    """The processing system's four clocks, and others that schemas name."""
    named = {name for config in spec.configs for name in config.clocks}
    numbered = "fclk{}" if spec.device.family.label == "7series" else "pl{}"
    return named | {numbered.format(index) for index in range(4)}


def _icap_names(spec: BoardSpec) -> list[str]:
    """The ports that regions name; all of them lead to the one configuration engine."""
    regions = [region for config in spec.configs for region in config.regions.values()]
    named = {r.loader_name for r in regions if r.loader in (LoaderKind.ICAP, LoaderKind.AUTO) and r.loader_name}
    return sorted({"cm_icap0", *named})
