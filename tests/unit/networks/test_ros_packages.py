# SPDX-License-Identifier: Apache-2.0
"""The ROS packages of ros2/, read by ROS's own tools if they are installed."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from unittest.mock import MagicMock

import pytest
import yaml

from cm.networks.bridge.records import Caller
from cm.networks.ros.node import BoardNode, NodeName
from cm.networks.ros.streams import ReadableStream, WritableStream
from cm.networks.ros.transport import FRAMES

ROOT = Path(__file__).resolve().parents[3]
ROS2 = ROOT / "ros2"
INTERFACES = ROS2 / "cm_interfaces"
SOURCES = sorted(
    path.relative_to(INTERFACES) for kind in ("msg", "srv", "action") for path in (INTERFACES / kind).iterdir()
)
SYSTEM = "/usr/bin/python3"  # Debian's, which sees python3-rosidl

_READ = """
import sys
from pathlib import Path
from rosidl_adapter import convert_to_idl
from rosidl_parser.definition import IdlLocator
from rosidl_parser.parser import parse_idl_file
out = Path(sys.argv[2])
for name in sys.argv[3:]:
    written = convert_to_idl(Path(sys.argv[1]), "cm_interfaces", Path(name), out / Path(name).parent)
    assert parse_idl_file(IdlLocator(out, written.relative_to(out))).content.elements, name
print(len(sys.argv) - 3)
"""


def has_rosidl() -> bool:
    done = subprocess.run(
        [SYSTEM, "-c", "import rosidl_adapter.resource, rosidl_parser.parser"], capture_output=True, check=False
    )
    return done.returncode == 0


def test_rosidl_reads_every_interface(tmp_path: Path) -> None:
    if not Path(SYSTEM).exists() or not has_rosidl():
        pytest.skip("needs_rosidl: Debian's python3-rosidl and python3-empy")
    for source in SOURCES:
        (tmp_path / source.parent).mkdir(exist_ok=True)
    done = subprocess.run(
        [SYSTEM, "-c", _READ, INTERFACES, tmp_path, *map(str, SOURCES)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[-1]) == len(SOURCES) > 15


def test_every_interface_is_built() -> None:
    text = (INTERFACES / "CMakeLists.txt").read_text()
    assert sorted(re.findall(r"^  ((?:msg|srv|action)/\S+)$", text, re.MULTILINE)) == sorted(map(str, SOURCES))


@pytest.mark.parametrize("package", ["cm_interfaces", "cm_ros2"])
def test_a_package_says_what_it_is_by_format_3(package: str) -> None:
    tree = ET.parse(ROS2 / package / "package.xml").getroot()
    assert (tree.get("format"), tree.findtext("name"), tree.findtext("license")) == ("3", package, "Apache-2.0")
    kind = "ament_cmake" if package == "cm_interfaces" else "ament_python"
    assert tree.findtext("export/build_type") == kind


def test_the_package_of_the_node_names_the_client_and_rosdep_finds_it() -> None:
    """Everything that the node imports beyond ROS's own packages."""
    depends = [found.text for found in ET.parse(ROS2 / "cm_ros2" / "package.xml").getroot().findall("exec_depend")]
    keys = yaml.safe_load((ROS2 / "rosdep.yaml").read_text())
    debian = re.findall(r"^Package: (\S+)", (ROOT / "debian" / "control").read_text(), re.MULTILINE)
    assert set(keys) <= set(depends)
    assert {package for systems in keys.values() for named in systems.values() for package in named} <= set(debian)
    sources = "".join(path.read_text() for path in (ROS2 / "cm_ros2" / "cm_ros2").iterdir() if path.suffix == ".py")
    imported = set(re.findall(r"^(?:from|import) (\w+)", sources, re.MULTILINE)) - sys.stdlib_module_names
    assert imported == {"cm", "cm_ros2", "numpy", "rclpy"}


def _of(enclave: str, kind: str, what: str) -> set[str]:
    """Names that SROS 2's policy lets an enclave, ``~`` being the node."""
    root = ET.parse(ROS2 / "cm_ros2/config/sros2_policy.xml").getroot()
    found = root.iterfind(f"enclaves/enclave[@path='{enclave}']/profiles/profile/{kind}s[@{what}='ALLOW']/{kind}")
    return {(name.text or "").replace("~", "/cm") for name in found}


def test_sros2_lets_the_node_publish_and_answer_what_it_does_and_nothing_else() -> None:
    transport = MagicMock()
    BoardNode(transport, NodeName(), MagicMock())
    for encoding in ("rgb8", ""):  # a stream of pictures, and one of other frames, both ways
        stream = MagicMock(encoding=encoding)
        ReadableStream(transport, "/cm/*", stream, MagicMock(), FRAMES)
        WritableStream(transport, "/cm/*", stream, MagicMock(), Caller(""), FRAMES)
    topics = {call.args[0] for call in transport.publisher.call_args_list if "/_action/" not in call.args[0]}
    services = {call.args[0] for call in transport.service.call_args_list if "/_action/" not in call.args[0]}
    lifecycle = (
        "change_state",
        "get_available_states",
        "get_available_transitions",
        "get_state",
        "get_transition_graph",
    )
    assert _of("/cm", "topic", "publish") == topics | {"/cm/transition_event", "/rosout"}
    assert _of("/cm", "topic", "subscribe") - {"/clock", "/parameter_events"} == {
        call.args[0] for call in transport.frames.call_args_list
    }
    assert _of("/cm", "service", "reply") == services | {f"/cm/{name}" for name in lifecycle}
    assert _of("/cm", "action", "execute") == {"/cm/change_mode"} == _of("/operator", "action", "call")


def test_sros2_lets_a_viewer_ask_for_nothing_that_changes_the_board() -> None:
    asked = _of("/viewer", "service", "request")
    assert asked <= _of("/operator", "service", "request") == _of("/cm", "service", "reply")
    assert not [name for name in asked if re.search("set|write|load|change", name)]
    assert not _of("/viewer", "action", "call")
    assert _of("/viewer", "topic", "publish").isdisjoint(_of("/cm", "topic", "subscribe") - {"/parameter_events"})


def test_parameters_of_the_example_are_those_that_the_node_declares() -> None:
    given = yaml.safe_load((ROS2 / "cm_ros2" / "config" / "board.yaml").read_text())["/**"]["ros__parameters"]
    declared = re.findall(r'declare_parameter\("(\w+)"', (ROS2 / "cm_ros2" / "cm_ros2" / "node.py").read_text())
    assert list(given) == declared


def test_the_package_of_the_node_installs_what_ros_looks_for(tmp_path: Path) -> None:
    """As colcon installs an ament_python package: by its setup.py."""
    shutil.copytree(ROS2 / "cm_ros2", tmp_path / "cm_ros2")
    command = [sys.executable, "setup.py", "-q", "install", "--prefix", tmp_path / "out", "--record", "record"]
    done = subprocess.run(
        [*command, "--single-version-externally-managed"],
        cwd=tmp_path / "cm_ros2",
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    installed = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*")}
    assert {
        "lib/cm_ros2/board",
        "share/cm_ros2/package.xml",
        "share/cm_ros2/launch/board.launch.py",
        "share/cm_ros2/config/cyclonedds.xml",
        "share/ament_index/resource_index/packages/cm_ros2",
    } <= installed


@pytest.mark.elsewhere
def test_colcon_builds_the_package_of_the_node(tmp_path: Path) -> None:
    colcon = shutil.which("colcon") or shutil.which("colcon", path=str(Path(sys.executable).parent))
    if colcon is None:
        pytest.skip("needs_colcon: pip install colcon-common-extensions")
    shutil.copytree(ROS2 / "cm_ros2", tmp_path / "src" / "cm_ros2")
    done = subprocess.run([colcon, "build"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "install" / "cm_ros2" / "lib" / "cm_ros2" / "board").exists()
