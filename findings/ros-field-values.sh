#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a value out of a field's range is an AssertionError in rclpy: the generated classes are full of assertions.
# Seen: nothing is checked unless ROS_PYTHON_CHECK_FIELDS is 1: 300 in a uint8 is kept, read back as 300 and sent as 44.
# The wheel of rclpy names no middleware that it needs: without one beside it, it cannot be imported.
. "$(dirname "$0")/setup"
pypi ros-rclpy==9.1.2
without=$(python3 -c "import rclpy" 2>&1 | grep -o "librmw_fastrtps_cpp.so: cannot open" || true)
venv/bin/pip install -qq --disable-pip-version-check --no-compile ros-rmw-fastrtps-cpp==9.3.3
cat >sent.py <<'END'
import sys

from rcl_interfaces.msg import Log
from rclpy.serialization import deserialize_message, serialize_message
from saw import saw

if len(sys.argv) > 1:
    saw("rclpy without a middleware", sys.argv[1], "librmw_fastrtps_cpp.so: cannot open")
    made = Log(level=300, line=2**32 + 5)
    sent = deserialize_message(serialize_message(made), Log)
    saw("level: set, sent", (made.level, sent.level), (300, 44))
    saw("line: set, sent", (made.line, sent.line), (2**32 + 5, 5))
else:
    try:
        raised = type(Log(level=300)).__name__
    except AssertionError as error:
        raised = type(error).__name__
    saw("with ROS_PYTHON_CHECK_FIELDS=1", raised, "AssertionError")
END
python3 sent.py "$without"
ROS_PYTHON_CHECK_FIELDS=1 python3 sent.py
