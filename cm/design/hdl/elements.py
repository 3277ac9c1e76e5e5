# SPDX-License-Identifier: Apache-2.0
"""Elements of IP-XACT files by their names without namespace, so that 1685-2009 and 1685-2014 read alike."""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree import ElementTree

from cm.formats.hwh.markup import root_of


def component_root(data: bytes) -> ElementTree.Element:
    """Parse a file's bytes and return the root element. Raises ValueError for what is not XML.

    Real files have licence comments before the XML declaration, although XML does not allow that.
    """
    return root_of(data[max(data.find(b"<?xml"), 0) :])


def local(tag: str) -> str:
    """A tag or an attribute's name without namespace; empty for a comment, whose tag is not text."""
    return tag.rpartition("}")[2] if isinstance(tag, str) else ""


def children(node: ElementTree.Element, name: str) -> Iterator[ElementTree.Element]:
    """Direct children of this name."""
    return (child for child in node if local(child.tag) == name)


def descendants(node: ElementTree.Element, name: str) -> Iterator[ElementTree.Element]:
    """Elements of this name at any depth, in document order."""
    return (child for child in node.iter() if local(child.tag) == name)


def text_of(node: ElementTree.Element, name: str) -> str:
    """Text of the first direct child of this name, without surrounding white space; empty if there is none."""
    found = next(children(node, name), None)
    return (found.text or "").strip() if found is not None else ""
