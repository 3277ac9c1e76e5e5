# SPDX-License-Identifier: Apache-2.0
"""ros2/cm_interfaces without comments and constants; ``python ros2/write_cm_interfaces.py`` writes it."""

from __future__ import annotations

from types import MappingProxyType

OWN = MappingProxyType(
    {
        "cm_interfaces/msg/Configuration": (
            "std_msgs/Header header\n"
            "string name\n"
            "string mode\n"
            "Mode[] modes\n"
            "string[] interrupts\n"
            "string[] readable_streams\n"
            "string[] writable_streams"
        ),
        "cm_interfaces/msg/Data": (
            "std_msgs/Header header\nstring stream\nuint64 sequence\nuint32[] shape\nstring dtype\nuint8[] data"
        ),
        "cm_interfaces/msg/Interrupt": ("std_msgs/Header header\nstring name\nuint64 count"),
        "cm_interfaces/msg/Mode": ("string name\nstring[] modules\nstring[] registers"),
        "cm_interfaces/msg/PlanStep": ("string kind\nstring subject\nstring text\nuint64 bytes\nfloat64 seconds"),
        "cm_interfaces/msg/Region": ("string name\nstring module\nstring state"),
        "cm_interfaces/msg/Register": ("string name\nuint64 value\nRegisterField[] fields"),
        "cm_interfaces/msg/RegisterBank": (
            "std_msgs/Header header\nstring config_name\nstring mode\nuint64 generation\nRegister[] registers"
        ),
        "cm_interfaces/msg/RegisterField": ("string name\nuint64 value"),
        "cm_interfaces/msg/RegisterWrite": ("string name\nuint64 value\nbool use_mask\nuint64 mask\nstring value_name"),
        "cm_interfaces/msg/Status": (
            "std_msgs/Header header\n"
            "string board\n"
            "string config_name\n"
            "string mode\n"
            "bool fpga_busy\n"
            "string pr_mode\n"
            "uint64 sequence\n"
            "string target_config\n"
            "string target_mode\n"
            "string step\n"
            "string subject\n"
            "float32 fraction\n"
            "uint64 last_change\n"
            "float64 last_change_seconds\n"
            "string error_code\n"
            "string error_message\n"
            "Region[] regions\n"
            "string[] configs"
        ),
        "cm_interfaces/srv/LoadConfig": (
            "string config_name\n"
            "string mode\n"
            "bool force\n"
            "string lease\n"
            "---\n"
            "bool success\n"
            "string code\n"
            "string message\n"
            "float64 seconds"
        ),
        "cm_interfaces/srv/Plan": (
            "string config_name\n"
            "string mode\n"
            "---\n"
            "bool success\n"
            "string code\n"
            "string message\n"
            "PlanStep[] steps\n"
            "uint64 bytes\n"
            "float64 seconds"
        ),
        "cm_interfaces/srv/ReadRegisters": (
            "string[] names\n---\nbool success\nstring code\nstring message\nRegisterBank bank"
        ),
        "cm_interfaces/srv/SetMode": (
            "string mode\nstring lease\n---\nbool success\nstring code\nstring message\nfloat64 seconds"
        ),
        "cm_interfaces/srv/WriteRegisters": (
            "RegisterWrite[] writes\nstring lease\n---\nbool success\nstring code\nstring message\nRegisterBank bank"
        ),
        "cm_interfaces/action/ChangeMode": (
            "string config_name\n"
            "string mode\n"
            "bool force\n"
            "string lease\n"
            "---\n"
            "bool success\n"
            "string code\n"
            "string message\n"
            "float64 seconds\n"
            "---\n"
            "string step\n"
            "string subject\n"
            "uint64 bytes_done\n"
            "uint64 bytes_total\n"
            "float32 fraction"
        ),
    }
)
