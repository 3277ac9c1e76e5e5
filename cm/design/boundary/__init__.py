# SPDX-License-Identifier: Apache-2.0
"""The common boundary of the modules that share a region, and how each is fitted to it: `make.boundary`."""
