# SPDX-License-Identifier: Apache-2.0
"""Files that others define, read and written: bitstreams, Project X-Ray, Vivado's .hwh, device trees, foreign packages.

In: bytes from outside, which are believed nothing. Out: frozen data, or an error that says what was wrong and where.
It must not know what is done with them: no manager, no design, no network.
"""
