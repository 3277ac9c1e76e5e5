# SPDX-License-Identifier: Apache-2.0
"""The bill of materials of a release as CycloneDX 1.6: the package, and what it depends on at run time.

    release/sbom.py OUT

Only what `pyproject.toml` declares, with its bounds: which versions run beside it, a board's system decides.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import sys
import uuid
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, metadata, requires
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
NAME = "fpga-cm"


def component(requirement: str) -> dict[str, Any]:
    """A library as it is declared; its licence as its own metadata says it."""
    found = re.match(r"([\w.\-]+)\s*(.*)", requirement)
    assert found is not None
    name, bounds = found[1], found[2].partition(";")[0].strip()
    part: dict[str, Any] = {
        "type": "library",
        "bom-ref": f"pkg:pypi/{name.lower()}",
        "name": name,
        "purl": f"pkg:pypi/{name.lower()}",
        "scope": "required",
        "properties": [{"name": "fpga-cm:version", "value": bounds or "any"}],
    }
    licence = _licence(name)
    return part | ({"licenses": [{"license": {"name": licence}}]} if licence else {})


def _licence(name: str) -> str:
    try:
        told = metadata(name)
    except PackageNotFoundError:
        return ""
    text = told.get("License-Expression") or told.get("License") or ""
    return text if "\n" not in text and text != "UNKNOWN" else ""


def bill(version: str, artefacts: list[Path]) -> dict[str, Any]:
    """The whole bill; the same for the same tree and artefacts."""
    parts = [component(line) for line in requires(NAME) or [] if "extra ==" not in line]
    hashes = [{"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()} for path in artefacts]
    serial = uuid.uuid5(uuid.NAMESPACE_URL, f"{NAME} {version} {json.dumps(hashes)}")
    when = datetime.fromtimestamp(int(os.environ.get("SOURCE_DATE_EPOCH", "0")), timezone.utc)
    reference = f"pkg:pypi/{NAME}@{version}"
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{serial}",
        "version": 1,
        "metadata": {
            "timestamp": when.strftime("%Y-%m-%dT%H:%M:%SZ"),
            "component": {
                "type": "application",
                "bom-ref": reference,
                "name": NAME,
                "version": version,
                "purl": reference,
                "licenses": [{"expression": "Apache-2.0 AND CC0-1.0"}],
                "properties": [{"name": "fpga-cm:sha256:" + h["file"], "value": h["sha256"]} for h in hashes],
            },
        },
        "components": parts,
        "dependencies": [{"ref": reference, "dependsOn": [part["bom-ref"] for part in parts]}],
    }


def main() -> int:
    """Write the bill; the exit status."""
    sys.path.insert(0, str(ROOT))
    from cm._version import __version__

    out = Path(sys.argv[1])
    artefacts = sorted(path for path in out.parent.iterdir() if path.suffix in (".gz", ".whl", ".deb"))
    out.write_text(json.dumps(bill(__version__, artefacts), indent=2) + "\n", encoding="utf-8")
    print(out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
