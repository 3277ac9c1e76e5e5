# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with a database of Project X-Ray, or with features that are to become frames."""

from __future__ import annotations

from typing import ClassVar

from cm.errors import CmError


class XrayError(CmError):
    """The database, a line of FASM or a set of features is not what it should be; the sentence says where."""

    code: ClassVar[str] = "xray"


class DatabaseMissing(XrayError):
    """There is no database of Project X-Ray here, or it does not have the part."""

    code: ClassVar[str] = "xray_database_missing"
