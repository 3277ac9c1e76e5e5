# SPDX-License-Identifier: Apache-2.0
"""ros2/cm_interfaces without comments and constants; ``python ros2/write_cm_interfaces.py`` writes it."""

from __future__ import annotations

from types import MappingProxyType

OWN = MappingProxyType(
    {
        "cm_interfaces/msg/Configuration": (
            "std_msgs/Header header\nstring name\nstring mode\nMode[] modes\nstring[] interrupts\n"
            "string[] readable_streams\nstring[] writable_streams"
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
            "std_msgs/Header header\nstring board\nstring config_name\nstring mode\nbool fpga_busy\n"
            "string pr_mode\nuint64 sequence\nstring target_config\nstring target_mode\nstring step\n"
            "string subject\nfloat32 fraction\nuint64 last_change\nfloat64 last_change_seconds\nstring error_code\n"
            "string error_message\nRegion[] regions\nstring[] configs"
        ),
        "cm_interfaces/srv/LoadConfig": (
            "string config_name\nstring mode\nbool force\nstring lease\n---\nbool success\nstring code\n"
            "string message\nfloat64 seconds"
        ),
        "cm_interfaces/srv/Plan": (
            "string config_name\nstring mode\n---\nbool success\nstring code\nstring message\nPlanStep[] steps\n"
            "uint64 bytes\nfloat64 seconds"
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
            "string config_name\nstring mode\nbool force\nstring lease\n---\nbool success\nstring code\n"
            "string message\nfloat64 seconds\n---\nstring step\nstring subject\nuint64 bytes_done\n"
            "uint64 bytes_total\nfloat32 fraction"
        ),
    }
)
