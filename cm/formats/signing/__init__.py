# SPDX-License-Identifier: Apache-2.0
"""Signed configurations: who made the files of a folder, and whether they are unchanged."""

from cm.formats.signing.errors import SignatureRefused as SignatureRefused
from cm.formats.signing.errors import SigningUnavailable as SigningUnavailable
from cm.formats.signing.keys import public_keys as public_keys
from cm.formats.signing.keys import sign as sign
from cm.formats.signing.manifest import Manifest as Manifest
from cm.formats.signing.manifest import add_manifest as add_manifest
from cm.formats.signing.policy import Policy as Policy
from cm.formats.signing.policy import judge as judge
