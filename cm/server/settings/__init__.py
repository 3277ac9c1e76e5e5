# SPDX-License-Identifier: Apache-2.0
"""The settings of the service: ``/etc/cm/cm.yaml`` (docs/service.md).

`loader` imports the reader of YAML, so a start without a settings file leaves it alone.
"""
