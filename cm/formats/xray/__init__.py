# SPDX-License-Identifier: Apache-2.0
"""Project X-Ray's public database of 7-series devices: features ↔ frames, tiles, wires and pips.

Frames are numbers (`cm.formats.xray.frames`), features are named as in the database (`cm.formats.xray.features`).
"""

from cm.formats.xray.coding import bits_of as bits_of
from cm.formats.xray.coding import decode as decode
from cm.formats.xray.coding import describe_bits as describe_bits
from cm.formats.xray.coding import encode as encode
from cm.formats.xray.coding import tiles_with_bits as tiles_with_bits
from cm.formats.xray.database import Database as Database
from cm.formats.xray.database import find_database as find_database
from cm.formats.xray.features import DatabaseMissing as DatabaseMissing
from cm.formats.xray.features import Feature as Feature
from cm.formats.xray.features import XrayError as XrayError
from cm.formats.xray.features import fasm as fasm
from cm.formats.xray.features import read_features as read_features
from cm.formats.xray.frames import from_bytes as from_bytes
from cm.formats.xray.frames import set_bits as set_bits
from cm.formats.xray.frames import to_bytes as to_bytes
from cm.formats.xray.frames import with_ecc as with_ecc
from cm.formats.xray.tiles import Tile as Tile
from cm.formats.xray.volatile import volatile_bits as volatile_bits
from cm.formats.xray.wires import Pip as Pip
from cm.formats.xray.wires import SitePins as SitePins
from cm.formats.xray.wires import Wires as Wires
from cm.formats.xray.wires import two_drivers as two_drivers
