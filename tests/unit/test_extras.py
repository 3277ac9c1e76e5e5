# SPDX-License-Identifier: Apache-2.0
"""What a message says of a missing package can be installed from an index that does not have this one."""

from __future__ import annotations

from importlib import metadata

import pytest

from cm.extras import installing


def test_what_is_missing_is_named_by_its_packages() -> None:
    assert installing("web") == "pip install 'aiohttp>=3.8.4' 'pillow>=9.4'"


def test_where_the_package_was_not_installed_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "requires", absent)
    assert installing("web") == "pip install 'fpga-cm[web]'"
