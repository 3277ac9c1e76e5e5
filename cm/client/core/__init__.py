# SPDX-License-Identifier: Apache-2.0
"""What a client does, without sockets, threads or event loops; blocking and asyncio clients add only the waiting.

A single request is a `calls.Call`. What takes several steps is a flow (`effects.Flow`): a generator that
gives what it needs next (an answer, an event, a pause) and returns the result.
"""
