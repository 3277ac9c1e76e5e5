# SPDX-License-Identifier: Apache-2.0
"""The programmable logic of a simulated board as its RTL: the tree that `cm build` generates, run by Verilator.

`cm.simulation.rtl.design` says what there is, `cm.simulation.rtl.compile` makes libraries of it, `cm.simulation.rtl.process` runs them in a process of
its own, and `cm.simulation.rtl.logic` is what `cm.simulation.software` sees: bus, streams, interrupts and configuration port.
"""
