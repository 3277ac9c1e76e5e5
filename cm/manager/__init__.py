# SPDX-License-Identifier: Apache-2.0
"""The core: plans the steps from the board's present state to the wanted one, and takes them so they can be undone.

In: requests by name, and what it is given: devices, files, a store and a clock (`interfaces`). Out: changes of the
board, its status, registers and memories by name. It must not know sockets, protobuf, classes of devices, paths.
"""
