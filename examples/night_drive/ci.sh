#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# What a CI runs: an environment with the package, Verilator from the distribution, the tests.
set -eu
cd "$(dirname "$0")"
command -v verilator >/dev/null || { apt-get update -qq && apt-get install -y -qq verilator g++; }
python3 -m venv "${VENV:=.venv}"
"$VENV/bin/pip" install -q "${FPGA_CM:-fpga-cm}[build]" pytest
"$VENV/bin/pytest" -q
