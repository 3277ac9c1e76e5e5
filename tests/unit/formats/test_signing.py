# SPDX-License-Identifier: Apache-2.0
"""Signed configurations: what is accepted, what is refused, and by which policy."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
from import_support import key_pair

from cm.cli.main import main
from cm.cli.serve_settings import configs_of
from cm.formats.signing import Policy, SignatureRefused, SigningUnavailable, add_manifest, judge, sign
from cm.server.settings.loader import parse_settings

pytest.importorskip("cryptography", reason="cryptography is not installed")

SCHEMA = b"config: {name: vision, modules: {a: {}}, modes: {default: {modules: [a]}}}\n"
FILES = {"vision.yaml": SCHEMA, "a.bit": b"some bytes"}


class Place:
    """Keys, and archives and folders that are signed with them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.signers = folder / "signers"
        self.key = key_pair(folder, "release", self.signers)

    def signed(self, version: int = 7, *keys: Path) -> dict[str, bytes]:
        files = add_manifest("vision", version, FILES)
        return {**files, "manifest.sig": sign(files["manifest.json"], list(keys or [self.key]))}

    def put(self, files: dict[str, bytes], name: str = "vision") -> Path:
        target = self.folder / "put" / name
        target.mkdir(parents=True)
        for file, data in files.items():
            (target / file).write_bytes(data)
        return target

    def packed(self, files: dict[str, bytes]) -> Path:
        path = self.folder / "vision.tar.gz"
        with tarfile.open(path, "w:gz") as tar:
            for name, data in files.items():
                member = tarfile.TarInfo(f"vision/{name}")
                member.size = len(data)
                tar.addfile(member, io.BytesIO(data))
        return path

    def policy(self, signatures: str = "require", older: str = "allow") -> Policy:
        return Policy(signatures, self.signers, older)

    def settings(self, **policy: str) -> Path:
        path = self.folder / "cm.yaml"
        path.write_text(json.dumps({"policy": {"signers": str(self.signers), **policy}}))
        return path


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


def test_what_a_trusted_key_has_signed_is_taken_and_its_name_reported(place: Place) -> None:
    found = judge(place.put(place.signed()), "vision", place.policy())
    assert (found.signer, found.version, found.warning) == ("release", 7, None)


def test_one_of_several_signatures_is_enough(place: Place) -> None:
    other = key_pair(place.folder, "other", place.folder / "elsewhere")
    assert judge(place.put(place.signed(7, other, place.key)), "vision", place.policy()).signer == "release"


def changed(files: dict[str, bytes], what: str) -> dict[str, bytes]:
    """The same files with one thing changed that nobody signed."""
    if what == "file":
        return {**files, "a.bit": b"other bytes"}
    if what == "schema":
        return {**files, "vision.yaml": SCHEMA + b"\n"}
    if what == "extra":
        return {**files, "b.bit": b""}
    if what in ("a.bit", "manifest.json", "manifest.sig"):
        return {name: data for name, data in files.items() if name != what}
    if what == "version":
        return {**files, "manifest.json": files["manifest.json"].replace(b'"version": 7', b'"version": 8')}
    if what == "signature":
        return {**files, "manifest.sig": files["manifest.sig"].replace(b'"release"', b'"nobody"')}
    return {**files, "manifest.sig": b"{}"}


WRONG = ("file", "schema", "extra", "a.bit", "manifest.json", "manifest.sig", "version", "signature", "empty")


@pytest.mark.parametrize("what", WRONG)
def test_changed_files_are_refused_or_reported(place: Place, what: str) -> None:
    folder = place.put(changed(place.signed(), what))
    with pytest.raises(SignatureRefused, match="vision"):
        judge(folder, "vision", place.policy())
    assert judge(folder, "vision", place.policy("warn")).warning
    assert judge(folder, "vision", place.policy("off")).warning is None


def test_every_flipped_bit_of_manifest_and_signature_is_refused(place: Place) -> None:
    files = place.signed()
    folder = place.put(files)
    for name in ("manifest.json", "manifest.sig"):
        data = bytearray(files[name])
        for at in range(len(data)):
            data[at] ^= 1 << at % 7
            (folder / name).write_bytes(data)
            try:
                judge(folder, "vision", place.policy())
            except SignatureRefused:
                pass
            else:  # white space in the list of signatures has no meaning
                assert name == "manifest.sig"
                assert json.loads(data) == json.loads(files[name])
            data[at] ^= 1 << at % 7
        (folder / name).write_bytes(data)


def test_a_key_that_is_not_trusted_does_not_count_as_a_signer(place: Place) -> None:
    other = key_pair(place.folder, "other", place.folder / "elsewhere")
    with pytest.raises(SignatureRefused, match="signed by other; the keys that are trusted here: release"):
        judge(place.put(place.signed(7, other)), "vision", place.policy())


def test_another_key_of_the_same_name_is_not_accepted(place: Place) -> None:
    other = key_pair(place.folder / "signers", "release", place.folder / "elsewhere")
    other.rename(place.folder / "release.pem")
    with pytest.raises(SignatureRefused, match="not that of this manifest"):
        judge(place.put(place.signed()), "vision", place.policy())


def test_signed_files_under_another_name_are_refused(place: Place) -> None:
    with pytest.raises(SignatureRefused, match="signed for configuration vision, not for other"):
        judge(place.put(place.signed(), "other"), "other", place.policy())


def test_an_older_version_is_refused_if_the_policy_says_so(place: Place) -> None:
    installed, new = place.put(place.signed(8)), place.put(place.signed(7), "new")
    assert judge(new, "vision", place.policy(), installed).version == 7
    with pytest.raises(SignatureRefused, match="version 7 is older than the one in force, 8"):
        judge(new, "vision", place.policy(older="refuse"), installed)


def test_if_required_signatures_cannot_be_checked_nothing_is_accepted(place: Place) -> None:
    """Without the library: in a separate process that cannot import it."""
    folder = place.put(place.signed())
    code = (
        "import sys; sys.modules['cryptography'] = None\n"
        "from pathlib import Path\nfrom cm.formats.signing import Policy, SigningUnavailable, judge\n"
        f"folder, signers = Path({str(folder)!r}), Path({str(place.signers)!r})\n"
        "assert 'cryptography' in judge(folder, 'vision', Policy('warn', signers)).warning\n"
        "assert judge(folder, 'vision', Policy('off', signers)).warning is None\n"
        "try:\n    judge(folder, 'vision', Policy('require', signers))\n"
        "except SigningUnavailable:\n    print('refused')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("refused", "")


def test_a_file_that_is_not_a_valid_key_is_named(place: Place) -> None:
    place.key.write_text("no key")
    with pytest.raises(SigningUnavailable, match=r"release\.pem: no private key"):
        place.signed()
    (place.signers / "bad.pem").write_text("no key")
    with pytest.raises(SigningUnavailable, match=r"bad\.pem: no public key"):
        judge(place.put(add_manifest("vision", 1, FILES)), "vision", place.policy())


def test_import_accepts_signed_archives_and_otherwise_keeps_the_present_version(
    place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    out = place.folder / "firmware"
    command = ["--out", str(out), "--settings", str(place.settings(signatures="require", older="refuse"))]
    assert main(["import", "archive", str(place.packed(place.signed(8))), *command]) == 0
    assert "signed by release, version 8" in capsys.readouterr().out
    held = {path.name: path.read_bytes() for path in (out / "vision").iterdir()}
    for files in (FILES, changed(place.signed(9), "file"), place.signed(7)):
        assert main(["import", "archive", str(place.packed(files)), *command]) == 1
        assert {path.name: path.read_bytes() for path in (out / "vision").iterdir()} == held
    warn = ["--out", str(out), "--settings", str(place.settings(signatures="warn"))]
    assert main(["import", "archive", str(place.packed(FILES)), *warn]) == 0
    assert "not signed" in capsys.readouterr().err


def test_the_service_leaves_out_unsigned_configurations(place: Place) -> None:
    good = place.put(place.signed())
    (place.folder / "put" / "bare").mkdir()
    (place.folder / "put/bare/bare.yaml").write_bytes(SCHEMA.replace(b"vision", b"bare"))
    text = place.settings(signatures="require").read_text()
    settings = parse_settings(json.dumps({**json.loads(text), "configs": [f"{place.folder}/put/*"]}))
    configs, told = configs_of([], settings)
    assert list(configs) == ["vision"]
    assert len(told) == 1
    assert "bare is left out" in told[0]
    assert configs_of([good], settings)[0].keys() == {"vision"}
    assert configs_of([place.folder / "put/bare"], settings)[0] == {}
