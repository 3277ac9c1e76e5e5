# SPDX-License-Identifier: Apache-2.0
"""Typed functions over the compiled module ``cm.native._cm``; nothing else imports that.

Functions raise OSError with the errno of the C call, copy results out, and hold no state.  cffi
releases the GIL around every call.  A handle is freed with its last reference; ``release`` closes
the device before that, and later calls on it raise OSError with EBADF.
"""
