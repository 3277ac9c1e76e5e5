# SPDX-License-Identifier: Apache-2.0
"""The core: from where the board is and where it should be to the steps between, taken so that they can be taken back.

In: requests by name, and what it is given: devices, files, a store and a clock (`interfaces`). Out: changes of the
board, its status, registers and memories by name. It must not know sockets, protobuf, classes of devices, paths.
"""
