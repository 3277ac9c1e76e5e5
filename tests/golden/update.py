# SPDX-License-Identifier: Apache-2.0
"""Write the golden files anew: ``python tests/golden/update.py``; then look at ``git diff``."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "unit")]

from build_support import EXAMPLES, GOLDEN, NAMES, SHIPPED, copy_examples, generated  # noqa: E402


def main() -> None:
    """Generate both examples and copy what is not a copy of a shipped file."""
    with tempfile.TemporaryDirectory() as folder:
        examples = copy_examples(Path(folder))
        for name in NAMES:
            _, out = generated(examples, name)
            shutil.rmtree(GOLDEN / name, ignore_errors=True)
            for path in sorted(out.rglob("*")):
                relative = path.relative_to(out)
                if path.is_file() and relative.parts[0][0] != "." and relative.parts[:2] != ("hdl", "lib"):
                    target = GOLDEN / name / relative
                    target.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(path, target)
        shutil.copyfile(GOLDEN / "camera" / SHIPPED, EXAMPLES / "camera" / SHIPPED)


if __name__ == "__main__":
    main()
