# SPDX-License-Identifier: Apache-2.0
"""The demonstration: the paper's observe–decide–act loop against a simulated board.

`application` is the autonomous application: bare pyzmq and the generated protobuf module, nothing else
of this package, as a program in any language would be. `runner` starts board, manager and application.
"""
