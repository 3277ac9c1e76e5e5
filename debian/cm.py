#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The command of the FPGA configuration manager."""

import sys

from cm.cli.main import main

sys.exit(main())
