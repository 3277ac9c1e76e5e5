# SPDX-License-Identifier: Apache-2.0
"""What cannot be simulated by its bits."""

from cm.errors import CmError


class BitsError(CmError):
    """Frames cannot be simulated; the text says which configured feature is not understood."""

    code = "bits_error"
