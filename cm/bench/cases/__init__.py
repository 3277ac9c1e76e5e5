# SPDX-License-Identifier: Apache-2.0
"""The measurements, one module each; `cm.bench.table` lists them."""
