# SPDX-License-Identifier: Apache-2.0
"""Boards without hardware, behind the same device nodes: models in software, the real RTL, or a bitstream's own bits.

In: runtime schemas, a design, bitstreams. Out: a process that serves ``$CM_ROOT/dev`` and ``$CM_ROOT/sys``, with faults
on request. It must not know the manager: what shares code with what it tests finds half of the mistakes.
"""
