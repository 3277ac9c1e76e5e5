# SPDX-License-Identifier: Apache-2.0
"""Errors of the build tool."""

from __future__ import annotations

from typing import ClassVar

from cm.errors import CmError


class BuildError(CmError):
    """The build tool cannot do something; the sentence says what would be right."""

    code: ClassVar[str] = "build_failed"


class StepFailed(BuildError):
    """A step of the flow, or a program that it runs, failed; the sentence contains an excerpt of its log."""

    code: ClassVar[str] = "step_failed"


class MissingTool(BuildError):
    """A program or an optional package is not installed; the sentence says how to get it."""

    code: ClassVar[str] = "missing_tool"
