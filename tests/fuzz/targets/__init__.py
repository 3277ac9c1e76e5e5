# SPDX-License-Identifier: Apache-2.0
"""One module for each reader of bytes from outside.

Each has `PACKAGES` (what is instrumented), `MAX_LENGTH` (bytes of an input), `seeds()` (valid inputs, from which the
fuzzer starts) and `one(data)`, which reads one input and catches the documented errors: any other is a finding.
"""
