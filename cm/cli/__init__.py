# SPDX-License-Identifier: Apache-2.0
"""The command `cm`: one module for each subcommand, imported only when that is called.

In: words, and files that they name. Out: text for people or JSON for scripts, and the exit status: 0, 1 for a refusal
or a failure, 2 for usage. It decides nothing: whatever is worth a test of its own stands in the room that it calls.
"""
