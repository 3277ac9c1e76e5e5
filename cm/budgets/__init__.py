# SPDX-License-Identifier: Apache-2.0
"""What each client takes of the manager, counted, and where it gets no more. No socket, no request: numbers.

Whose a connection is, `cm.rights` knows, and `cm.native.guard` what connections there are. The loop's thread.
"""
