# SPDX-License-Identifier: Apache-2.0
"""Run the notebooks on a simulated board and keep what they show, with small pictures.

After `make test-programs`: ``.venv/bin/python docs/notebook_outputs.py``.
"""

from __future__ import annotations

import base64
import io
import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import nbclient
import nbformat
from PIL import Image

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS.parent), str(DOCS.parent / "tests")]

from manager_process import served  # noqa: E402 (of the tests, which start the same)

_WIDTH = 400  # of the pictures that are kept: who runs a notebook sees them whole
_FOLDER = re.compile(r"ipc://\S*/req")  # where this manager's sockets were


def small(data: str) -> str:
    """A picture as it is kept: narrower, in 32 colours."""
    with Image.open(io.BytesIO(base64.b64decode(data))) as picture:
        picture.thumbnail((_WIDTH, _WIDTH))
        kept = io.BytesIO()
        picture.quantize(32).save(kept, "PNG", optimize=True)
    return base64.b64encode(kept.getvalue()).decode()


def keep(output: Any) -> None:
    """An output as notebooks show it, without what is only of this machine."""
    data = output.get("data", {})
    if len(data) > 1:
        data.pop("text/plain", None)  # which nobody sees where there is a table or a picture
    for kind, value in data.items():
        data[kind] = small(value) if kind == "image/png" else _FOLDER.sub("ipc:///run/cm/req", value)


def main() -> None:
    """All of them."""
    with tempfile.TemporaryDirectory() as folder, served(arguments=["--name", "simulated"]) as (manager, _):
        os.environ |= {"CM_RUNTIME_DIR": str(manager.runtime), "IPYTHONDIR": folder, "JUPYTER_RUNTIME_DIR": folder}
        os.environ["PYTHONPATH"] = str(DOCS.parent)
        for path in sorted((DOCS / "notebooks").glob("*.ipynb")):
            notebook = nbformat.read(path, as_version=4)
            nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": folder}}).execute()
            for cell in notebook.cells:
                cell.metadata.clear()  # when it ran
                for output in cell.get("outputs", ()):
                    keep(output)
            notebook.metadata["language_info"] = {"name": "python"}
            nbformat.write(notebook, path)
            print(f"{path}: {path.stat().st_size >> 10} KiB")


if __name__ == "__main__":
    main()
