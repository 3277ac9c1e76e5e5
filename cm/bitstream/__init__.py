# SPDX-License-Identifier: Apache-2.0
"""Bitstreams of AMD 7-series and UltraScale+ devices: read, checked, converted, assembled.

`docs/bitstreams.md` says what is checked and what each refusal means.
"""

from cm.bitstream.assemble import FrameRun as FrameRun
from cm.bitstream.assemble import SharedFrame as SharedFrame
from cm.bitstream.assemble import assemble as assemble
from cm.bitstream.cache import ReportCache as ReportCache
from cm.bitstream.container import BitHeader as BitHeader
from cm.bitstream.container import Container as Container
from cm.bitstream.container import Image as Image
from cm.bitstream.container import open_image as open_image
from cm.bitstream.convert import convert as convert
from cm.bitstream.convert import to_dma_words as to_dma_words
from cm.bitstream.devices import Device as Device
from cm.bitstream.devices import Family as Family
from cm.bitstream.devices import device_by_idcode as device_by_idcode
from cm.bitstream.devices import device_by_name as device_by_name
from cm.bitstream.errors import BitstreamError as BitstreamError
from cm.bitstream.far import FrameAddress as FrameAddress
from cm.bitstream.footprint import footprint_of as footprint_of
from cm.bitstream.footprint import outside as outside
from cm.bitstream.inspect import inspect as inspect
from cm.bitstream.module import ModuleIdentity as ModuleIdentity
from cm.bitstream.module import assemble_module as assemble_module
from cm.bitstream.module import default_footprint as default_footprint
from cm.bitstream.report import CrcResult as CrcResult
from cm.bitstream.report import Footprint as Footprint
from cm.bitstream.report import Refusal as Refusal
from cm.bitstream.report import Report as Report
from cm.bitstream.verify import Expectation as Expectation
from cm.bitstream.verify import expect_module as expect_module
from cm.bitstream.verify import expect_static as expect_static
from cm.bitstream.verify import refusals as refusals
from cm.bitstream.verify import verify as verify
