# SPDX-License-Identifier: Apache-2.0
"""The devices and files of this machine that the manager is given."""
