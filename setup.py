# SPDX-License-Identifier: Apache-2.0
"""What pyproject.toml cannot say: the C shims (cffi) and the generated modules."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from setuptools import __version__ as setuptools_version
from setuptools import setup
from setuptools.command.build_ext import build_ext
from setuptools.command.build_py import build_py
from setuptools.errors import SetupError

ROOT = Path(__file__).resolve().parent
PROTO = "cm/wire/cm.proto"
GENERATED = "cm/wire/cm_pb2.py"
CLASSES = "cm/wire/messages/_proto.py"
BLOCKING = {"cm/client/_operations.py": "cm/client/aio/operations.py", "cm/client/lease.py": "cm/client/aio/lease.py"}
SCHEMA = "cm/schema/data/runtime.schema.json"
VALIDATOR = "cm/schema/_validator.py"
INTERFACES = "cm/networks/rmw_zenoh/_cm_interfaces.py"
NO_PROTOC = (
    "cannot generate cm/wire/cm_pb2.py: no protobuf compiler found. Set PROTOC, or install one: "
    "'pip install grpcio-tools', or 'apt install protobuf-compiler'"
)
# Lines by which newer compilers tie the module to their own runtime. What is left needs the builder
# API only, which has been there since protobuf 3.20, so that one file runs on 3.21 up to the newest.
RUNTIME_CHECK = re.compile(
    r"^from google\.protobuf import runtime_version as _runtime_version\n"
    r"|^_runtime_version\.ValidateProtobufRuntimeVersion\((?:[^()]|\n)*\)\n",
    re.MULTILINE,
)


def protoc() -> list[str]:
    """Return the command of the protobuf compiler: $PROTOC, grpc_tools, or protoc on PATH."""
    if os.environ.get("PROTOC"):
        return [os.environ["PROTOC"]]
    if find_spec("grpc_tools") is not None:
        return [sys.executable, "-m", "grpc_tools.protoc"]
    found = shutil.which("protoc")
    if found is None:
        raise SetupError(NO_PROTOC)
    return [found]


def generate(target: Path) -> None:
    """Write the Python module of cm.proto to ``target``, free of the runtime's version check."""
    command = protoc()
    with tempfile.TemporaryDirectory() as folder:
        try:
            subprocess.run([*command, f"-I{ROOT}", f"--python_out={folder}", PROTO], check=True, cwd=ROOT)
        except (OSError, subprocess.CalledProcessError) as error:
            raise SetupError(f"cannot generate {GENERATED}: {' '.join(command)} failed: {error}") from error
        text = RUNTIME_CHECK.sub("", (Path(folder) / GENERATED).read_text(encoding="utf-8"))
    if "_runtime_version" in text:
        raise SetupError(f"{GENERATED}: this protobuf compiler writes a version check that setup.py does not know")
    written(target, text)


def written(target: Path, text: str) -> None:
    """Write a file, renamed into place: a Python that imports meanwhile sees the old one or the new one."""
    target.parent.mkdir(parents=True, exist_ok=True)
    scratch = target.with_name(target.name + ".new")
    scratch.write_text(text, encoding="utf-8")
    scratch.replace(target)


def generate_classes(target: Path) -> None:
    """Write the frozen classes of cm.proto's messages."""
    sys.path.insert(0, str(ROOT / "release"))
    try:
        from message_classes import source
    finally:
        sys.path.remove(str(ROOT / "release"))
    written(target, source((ROOT / PROTO).read_text(encoding="utf-8")))


def generate_blocking(target: Path, awaited: Path) -> None:
    """Write a module of the blocking client, from its twin in the asyncio client."""
    text = awaited.read_text(encoding="utf-8")
    words = {"async def __a": "def __", "async def ": "def ", "await ": "", "client.aio.": "client."}
    for word, other in words.items():
        text = text.replace(word, other)
    written(target, text)


def generate_interfaces(target: Path) -> None:
    """Write ros2/cm_interfaces as a module, without comments and constants."""
    found = {}
    for path in sorted((ROOT / "ros2/cm_interfaces").glob("*/*.*")):
        lines = [" ".join(line.partition("#")[0].split()) for line in path.read_text(encoding="utf-8").splitlines()]
        found[f"cm_interfaces/{path.parent.name}/{path.stem}"] = "\n".join(x for x in lines if x and "=" not in x)
    written(target, f'"""ros2/cm_interfaces; setup.py writes it."""\n\nOWN = {found!r}\n')


def generate_validator(target: Path) -> None:
    """Write the validator of the runtime schema, where what makes it is installed; else each start makes it anew."""
    sys.path.insert(0, str(ROOT))
    try:
        from cm.schema.compiled import source

        text = source((ROOT / SCHEMA).read_bytes())
    except (ImportError, ValueError) as error:
        print(f"{VALIDATOR} is left out ({error}): `cm` compiles it at each start")
        return
    finally:
        sys.path.remove(str(ROOT))
    written(target, text)


def generate_all(base: Path) -> None:
    """Everything that is generated, below a folder."""
    generate(base / GENERATED)
    generate_classes(base / CLASSES)
    for blocking, awaited in BLOCKING.items():
        generate_blocking(base / blocking, ROOT / awaited)
    generate_interfaces(base / INTERFACES)
    generate_validator(base / VALIDATOR)


class BuildPy(build_py):
    """Generates modules into what is built, or into the tree when that is what runs."""

    def _base(self) -> Path:
        return ROOT if self.editable_mode else Path(self.build_lib)

    def run(self) -> None:
        super().run()
        if not self.dry_run if hasattr(self, "dry_run") else True:
            generate_all(self._base())

    def get_outputs(self, include_bytecode: bool = True) -> list[str]:
        outputs = super().get_outputs(include_bytecode)
        base = self._base()
        made = [
            str(base / name)
            for name in (GENERATED, CLASSES, *BLOCKING, INTERFACES, VALIDATOR)
            if name != VALIDATOR or (base / name).exists()
        ]
        return [*outputs, *(target for target in made if target not in outputs)]


class BuildExt(build_ext):
    """Compiles side by side; generates modules beside their sources with ``build_ext --inplace``."""

    def build_extensions(self) -> None:
        compile_one = self.compiler.compile

        def compile_all(sources: list[str], **settings: Any) -> list[str]:
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                return [file for made in pool.map(lambda one: compile_one([one], **settings), sources) for file in made]

        self.compiler.compile = compile_all
        super().build_extensions()

    def run(self) -> None:
        super().run()
        if self.inplace:
            generate_all(ROOT)


# Free-threaded Python has no stable ABI yet; cffi builds a version-specific module there.
ABI3 = not sysconfig.get_config_var("Py_GIL_DISABLED")

# Core metadata 2.4 has a field for SPDX expressions, which setuptools writes from 77 on.
LICENSE_FIELD = "license_expression" if int(setuptools_version.split(".")[0]) >= 77 else "license"

# A client over TCP needs no shims; they are for what only Linux has. CM_PURE=1 makes that wheel on Linux.
SHIMS = sys.platform == "linux" and os.environ.get("CM_PURE", "") in ("", "0")

setup(
    **{LICENSE_FIELD: "Apache-2.0"},
    **({"cffi_modules": ["csrc/build_cffi.py:ffibuilder"]} if SHIMS else {}),
    cmdclass={"build_py": BuildPy, "build_ext": BuildExt},
    options={"bdist_wheel": {"py_limited_api": "cp310"}} if ABI3 and SHIMS else {},
)
