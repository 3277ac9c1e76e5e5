# SPDX-License-Identifier: Apache-2.0
"""Typed functions over the compiled module ``cm.device.native._cm``; nothing else imports that.

Functions raise OSError with the errno of the C call, copy results out, and hold no state.  cffi
releases the GIL around every call.  A handle is freed with its last reference; ``release`` closes
the device before that, and later calls on it raise OSError with EBADF.
"""

import sys
from importlib.util import find_spec

if sys.platform != "linux":
    raise ImportError("devices are reached on Linux only: here is the client, cm.connect('tcp://kria.local')")
if find_spec("cm.device.native._cm") is None:
    raise ImportError(
        "the C shims (cm.device.native._cm) are not built: install the package ('pip install .'), "
        "or build them in a work tree with 'python setup.py build_ext --inplace'"
    )
