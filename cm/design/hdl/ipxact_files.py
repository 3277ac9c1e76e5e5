# SPDX-License-Identifier: Apache-2.0
"""The files that an IP-XACT component's synthesis view lists."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from cm.design.hdl.elements import component_root, descendants, local, text_of
from cm.design.hdl.errors import HdlError

_SOURCES = ("verilogSource", "systemVerilogSource", "vhdlSource")


@dataclass(slots=True)
class ComponentFiles:
    """Files in order; VHDL that belongs to a named library is listed by library."""

    sources: list[Path] = field(default_factory=list)
    libraries: dict[str, list[Path]] = field(default_factory=dict)
    include_dirs: list[Path] = field(default_factory=list)
    ip: list[Path] = field(default_factory=list)
    constraints: list[Path] = field(default_factory=list)
    tcl: list[Path] = field(default_factory=list)


def component_files(path: Path) -> ComponentFiles:
    """Return the files for synthesis. Raises `HdlError` if one is missing, or if another component is needed."""
    try:
        root = component_root(path.read_bytes())
    except (OSError, ValueError) as error:
        raise HdlError(f"{path}: cannot be read: {error}") from None
    found = ComponentFiles()
    sets = {text_of(node, "name"): node for node in descendants(root, "fileSet")}
    for name in _synthesis(root):
        if name not in sets:
            continue
        for node in descendants(sets[name], "componentRef"):
            other = next((value for key, value in node.attrib.items() if local(key) == "name"), "another component")
            what = f"needs other IP ({other}): make an instance of it in Vivado, and give its .xci"
            raise HdlError(f"{path}: {what}")
        for node in descendants(sets[name], "file"):
            _add(found, path, node)
    return found


def _synthesis(root: ElementTree.Element) -> list[str]:
    """Names of the file sets for synthesis, each once; Verilog's, for a component in both languages."""
    names: dict[str, None] = {}
    kinds = [text_of(view, "envIdentifier") for view in descendants(root, "view")]
    both = any(kind.startswith("verilogSource") and kind.endswith(":synthesis") for kind in kinds)
    for view in descendants(root, "view"):
        kind = text_of(view, "envIdentifier")
        if both and kind.startswith("vhdlSource"):
            continue
        if kind.endswith((":synthesis", "synthesis.constraints")):
            names |= dict.fromkeys(text_of(ref, "localName") for ref in descendants(view, "fileSetRef"))
    return list(names)


def _add(found: ComponentFiles, component: Path, node: ElementTree.Element) -> None:
    path = component.parent / text_of(node, "name")
    kinds = [(child.text or "").strip() for child in node if local(child.tag) in ("fileType", "userFileType")]
    if not path.exists():
        raise HdlError(f"{component}: lists {text_of(node, 'name')}, which is not there")
    if text_of(node, "isIncludeFile") == "true":
        if path.parent not in found.include_dirs:
            found.include_dirs.append(path.parent)
    elif any(kind.startswith(_SOURCES) for kind in kinds):
        library = text_of(node, "logicalName")
        vhdl = any(kind.startswith("vhdl") for kind in kinds)
        named = vhdl and library not in ("", "work", "xil_defaultlib")
        (found.libraries.setdefault(library, []) if named else found.sources).append(path)
    elif path.suffix == ".xci":
        found.ip.append(path)
    elif path.suffix == ".xdc" and not any(kind.startswith("USED_IN_implementation") for kind in kinds):
        found.constraints.append(path)
