# SPDX-License-Identifier: Apache-2.0
"""Programs around the product: measurements, the demonstrations, the conformance test, the pytest plugin.

In: a manager, as a process or through its clients. Out: figures, pictures, verdicts. Nothing of the product imports it.
"""
