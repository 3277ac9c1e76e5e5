# SPDX-License-Identifier: Apache-2.0
"""Plans the system that is generated from a project and its regions' boundaries."""
