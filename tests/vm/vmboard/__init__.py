# SPDX-License-Identifier: Apache-2.0
"""Builds and runs the virtual board: kernel, root file system, our software, QEMU."""
