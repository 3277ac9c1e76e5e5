# SPDX-License-Identifier: Apache-2.0
"""The programmable logic of a simulated board as its RTL: the tree that `cm build` generates, run by Verilator.

`cm.rtl.design` says what there is, `cm.rtl.compile` makes libraries of it, `cm.rtl.process` runs them in a process of
its own, and `cm.rtl.logic` is what `cm.sim` sees: bus, streams, interrupts and configuration port.
"""
