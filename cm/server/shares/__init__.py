# SPDX-License-Identifier: Apache-2.0
"""How much of the manager each client uses, and its limits.

Only numbers: no sockets, no requests. `cm.server.rights` knows which client a connection belongs to, and
`cm.device.native.guard` which connections there are. In the loop's thread.
"""
