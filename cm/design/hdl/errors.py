# SPDX-License-Identifier: Apache-2.0
"""Errors of reading HDL, IP-XACT and protocol files."""

from __future__ import annotations

import sys
from typing import ClassVar

from cm.errors import CmError, NotFound
from cm.extras import installing


class HdlError(CmError, ValueError):
    """HDL, IP-XACT or a protocols file could not be read; the sentence names file and line."""

    code: ClassVar[str] = "hdl"


class ModuleNotFound(HdlError, NotFound):
    """None of the files has a module of that name; the sentence lists those that exist."""

    code: ClassVar[str] = "not_found"


class WrongParameter(HdlError):
    """A value that was given for the parameter or generic `name` is none that it can have."""

    def __init__(self, name: str, sentence: str) -> None:
        super().__init__(sentence)
        self.name = name


class UnknownParameter(WrongParameter, NotFound):
    """None of the requested modules has a parameter or generic of that `name`; the sentence lists those that exist."""

    code: ClassVar[str] = "not_found"


class ParserMissing(CmError, ImportError):
    """The parser for this language is not installed; the sentence says how to get it."""

    code: ClassVar[str] = "parser_missing"


def parser_missing(package: str, language: str) -> ParserMissing:
    """The error for a parser package that cannot be imported."""
    if package == "pyslang" and sys.version_info < (3, 11):
        return ParserMissing(f"reading {language} needs the Python package pyslang, which needs Python 3.11 or newer")
    return ParserMissing(
        f"reading {language} needs the Python package {package}, which is not installed: "
        f"{installing('build')} (or pip install {package})"
    )
