# SPDX-License-Identifier: Apache-2.0
"""XML files that other tools wrote."""

from __future__ import annotations

from xml.etree import ElementTree


def root_of(data: bytes) -> ElementTree.Element:
    """The root element. Raises ValueError with what is wrong, whichever part of the parser found it."""
    try:
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, LookupError) as error:  # LookupError: an unknown encoding
        raise ValueError(str(error)) from error
