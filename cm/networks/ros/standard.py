# SPDX-License-Identifier: Apache-2.0
"""The fields of ROS's own interfaces that the node uses, as its .msg and .srv files have them (tests compare them)."""

from __future__ import annotations

from types import MappingProxyType

STANDARD = MappingProxyType(
    {
        "action_msgs/msg/GoalInfo": "unique_identifier_msgs/UUID goal_id\nbuiltin_interfaces/Time stamp",
        "action_msgs/msg/GoalStatus": "GoalInfo goal_info\nint8 status",
        "action_msgs/msg/GoalStatusArray": "GoalStatus[] status_list",
        "action_msgs/srv/CancelGoal": "GoalInfo goal_info\n---\nint8 return_code\nGoalInfo[] goals_canceling",
        "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
        "diagnostic_msgs/msg/DiagnosticArray": "std_msgs/Header header\nDiagnosticStatus[] status",
        "diagnostic_msgs/msg/DiagnosticStatus": (
            "byte level\nstring name\nstring message\nstring hardware_id\nKeyValue[] values"
        ),
        "diagnostic_msgs/msg/KeyValue": "string key\nstring value",
        "rcl_interfaces/msg/FloatingPointRange": "float64 from_value\nfloat64 to_value\nfloat64 step",
        "rcl_interfaces/msg/IntegerRange": "int64 from_value\nint64 to_value\nuint64 step",
        "rcl_interfaces/msg/ListParametersResult": "string[] names\nstring[] prefixes",
        "rcl_interfaces/msg/Parameter": "string name\nParameterValue value",
        "rcl_interfaces/msg/ParameterDescriptor": (
            "string name\nuint8 type\nstring description\nstring additional_constraints\nbool read_only\n"
            "bool dynamic_typing\nFloatingPointRange[<=1] floating_point_range\nIntegerRange[<=1] integer_range"
        ),
        "rcl_interfaces/msg/ParameterEvent": (
            "builtin_interfaces/Time stamp\nstring node\nParameter[] new_parameters\nParameter[] changed_parameters\n"
            "Parameter[] deleted_parameters"
        ),
        "rcl_interfaces/msg/ParameterValue": (
            "uint8 type\nbool bool_value\nint64 integer_value\nfloat64 double_value\nstring string_value\n"
            "byte[] byte_array_value\nbool[] bool_array_value\nint64[] integer_array_value\n"
            "float64[] double_array_value\nstring[] string_array_value"
        ),
        "rcl_interfaces/msg/SetParametersResult": "bool successful\nstring reason",
        "rcl_interfaces/srv/DescribeParameters": "string[] names\n---\nParameterDescriptor[] descriptors",
        "rcl_interfaces/srv/GetParameterTypes": "string[] names\n---\nuint8[] types",
        "rcl_interfaces/srv/GetParameters": "string[] names\n---\nParameterValue[] values",
        "rcl_interfaces/srv/ListParameters": "string[] prefixes\nuint64 depth\n---\nListParametersResult result",
        "rcl_interfaces/srv/SetParameters": "Parameter[] parameters\n---\nSetParametersResult[] results",
        "rcl_interfaces/srv/SetParametersAtomically": "Parameter[] parameters\n---\nSetParametersResult result",
        "sensor_msgs/msg/CameraInfo": (
            "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
            "float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nRegionOfInterest roi"
        ),
        "sensor_msgs/msg/Image": (
            "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
            "uint8[] data"
        ),
        "sensor_msgs/msg/RegionOfInterest": (
            "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify"
        ),
        "service_msgs/msg/ServiceEventInfo": (
            "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number"
        ),
        "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
        "std_msgs/msg/String": "string data",
        "unique_identifier_msgs/msg/UUID": "uint8[16] uuid",
    }
)
