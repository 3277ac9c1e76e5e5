#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# `make test-ros`: builds cm_interfaces and cm_ros2 into build/ros, and runs the tests against a real ROS 2.
#   ros2/test.sh PYTHON [FOLDER]    FOLDER: an installed ROS 2 (with setup.bash, such as /opt/ros/jazzy), whose Python is
#                                   python3; without it: the wheels of Jazzy that PyPI has for x86-64, Python 3.10 to 3.13
set -euo pipefail
cd "$(dirname "$0")/.."
python=$1 folder=${2:-} out=$PWD/build/ros
mkdir -p "$out"

# What cm_interfaces is built with; their wheels name no dependency on one another.
wheels=(
	rclpy rmw-fastrtps-cpp sensor-msgs diagnostic-msgs service-msgs
	ament-package ament-cmake ament-cmake-{core,export-definitions,export-dependencies,export-include-directories}
	ament-cmake-{export-interfaces,export-libraries,export-link-flags,export-targets,gen-version-h,gmock,gtest}
	ament-cmake-{include-directories,libraries,pytest,python,ros,target-dependencies,test,version}
	domain-coordinator fastrtps-cmake-module gmock-vendor gtest-vendor python-cmake-module rpyutils
	rosidl-default-{generators,runtime} rosidl-core-{generators,runtime} rosidl-pycommon
	rosidl-generator-{c,cpp,py,type-description} rosidl-runtime-{c,cpp}
	rosidl-typesupport-{c,cpp,interface,fastrtps-c,fastrtps-cpp,introspection-c,introspection-cpp}
)

if [ -n "$folder" ]; then
	set +u
	. "$folder/setup.bash"
	set -u
	[ -x "$out/env/bin/python" ] || python3 -m venv --system-site-packages "$out/env"
else
	if ! "$python" -c 'import platform, sys; sys.exit(platform.machine() != "x86_64" or not (3, 10) <= sys.version_info[:2] <= (3, 13))'; then
		echo "SKIPPED: no ROS 2 (ROS=FOLDER names one), and PyPI has no rclpy for this machine"
		exit 0
	fi
	[ -x "$out/env/bin/python" ] || "$python" -m venv "$out/env"
	"$out/env/bin/python" -m pip install --quiet "${wheels[@]/#/ros-jazzy-}" cmake
	export AMENT_PREFIX_PATH=$out/env CMAKE_PREFIX_PATH=$out/env
	# The wheels' CMake files name the folders of the machine that they were built on.
	include=$("$out/env/bin/python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
	packages=$("$out/env/bin/python" -c 'import sysconfig; print(sysconfig.get_path("platlib"))')
	{ grep -rlE '/opt/python/[^/]*/(include|lib)' "$out/env/share" || true; } |
		xargs -r sed -i -E "s,/opt/python/[^/]*/include/python3[.0-9]*,$include,; s,/opt/python/[^/]*/lib/python3[.0-9]*/site-packages,$packages,"
fi
"$out/env/bin/python" -m pip install --quiet colcon-common-extensions pytest pytest-timeout hypothesis --editable '.[zenoh]'

export PATH=$out/env/bin:$PATH
colcon --log-base "$out/log" build --base-paths ros2 --build-base "$out/build" --install-base "$out/install" \
	--event-handlers console_direct- --cmake-args -DBUILD_TESTING=OFF "-DPython3_EXECUTABLE=$out/env/bin/python"
set +u
. "$out/install/local_setup.bash"
set -u
exec "$out/env/bin/python" -m pytest -q tests/integration/test_ros_rclpy.py ${PYTEST_ARGS:-}
