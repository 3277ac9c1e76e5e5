# SPDX-License-Identifier: Apache-2.0
"""The measurements, one module each; `cm.tools.bench.catalogue` lists them."""
