# SPDX-License-Identifier: Apache-2.0
"""Signed configurations: who made the files of a folder, and whether they are unchanged."""

from cm.signing.errors import SignatureRefused as SignatureRefused
from cm.signing.errors import SigningUnavailable as SigningUnavailable
from cm.signing.keys import public_keys as public_keys
from cm.signing.keys import sign as sign
from cm.signing.manifest import Manifest as Manifest
from cm.signing.manifest import add_manifest as add_manifest
from cm.signing.policy import Policy as Policy
from cm.signing.policy import judge as judge
