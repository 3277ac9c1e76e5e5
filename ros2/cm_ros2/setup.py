# SPDX-License-Identifier: Apache-2.0
"""The package of the node, as colcon builds it. The package `cm` (pip: fpga-cm) has to be installed beside it."""

from pathlib import Path

from setuptools import setup

NAME = "cm_ros2"

setup(
    name=NAME,
    version="0.2.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", sorted(map(str, Path("launch").glob("*.launch.py")))),
        (f"share/{NAME}/config", sorted(map(str, Path("config").iterdir()))),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="fpga-cm maintainers",
    maintainer_email="maintainers@fpga-cm.invalid",
    description="A board under the FPGA configuration manager as a ROS 2 lifecycle node.",
    license="Apache-2.0",
    entry_points={"console_scripts": ["board = cm_ros2.node:main"]},
)
