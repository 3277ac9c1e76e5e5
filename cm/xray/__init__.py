# SPDX-License-Identifier: Apache-2.0
"""Project X-Ray's public database of 7-series devices: features ↔ frames, tiles, wires and pips.

Frames are numbers (`cm.xray.frames`), features are named as in the database (`cm.xray.features`).
"""

from cm.xray.database import Database as Database
from cm.xray.database import find_database as find_database
from cm.xray.decode import Decoded as Decoded
from cm.xray.decode import decode as decode
from cm.xray.decode import tiles_with_bits as tiles_with_bits
from cm.xray.encode import Clash as Clash
from cm.xray.encode import Encoded as Encoded
from cm.xray.encode import bits_of as bits_of
from cm.xray.encode import encode as encode
from cm.xray.errors import DatabaseMissing as DatabaseMissing
from cm.xray.errors import XrayError as XrayError
from cm.xray.features import Feature as Feature
from cm.xray.features import Setting as Setting
from cm.xray.features import fasm as fasm
from cm.xray.features import parse as parse
from cm.xray.features import read_features as read_features
from cm.xray.frames import Frames as Frames
from cm.xray.frames import ecc as ecc
from cm.xray.frames import from_bytes as from_bytes
from cm.xray.frames import set_bits as set_bits
from cm.xray.frames import to_bytes as to_bytes
from cm.xray.frames import with_ecc as with_ecc
from cm.xray.tiles import Segment as Segment
from cm.xray.tiles import Tile as Tile
from cm.xray.wires import Pip as Pip
from cm.xray.wires import SitePins as SitePins
from cm.xray.wires import Wires as Wires
