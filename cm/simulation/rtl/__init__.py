# SPDX-License-Identifier: Apache-2.0
"""The programmable logic of a simulated board as its RTL: the tree that `cm build` generates, run by Verilator.

`design` says what there is, `compile` makes libraries of it, `process` runs them in a process of its own, and `logic`
is what `cm.simulation.software` sees: bus, streams, interrupts and configuration port.
"""
