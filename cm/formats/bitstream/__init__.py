# SPDX-License-Identifier: Apache-2.0
"""Bitstreams of AMD 7-series and UltraScale+ devices: read, checked, converted, assembled.

`docs/bitstreams.md` says what is checked and what each refusal means.
"""

from cm.formats.bitstream.assemble import FrameRun as FrameRun
from cm.formats.bitstream.assemble import SharedFrame as SharedFrame
from cm.formats.bitstream.assemble import assemble as assemble
from cm.formats.bitstream.container import BitHeader as BitHeader
from cm.formats.bitstream.container import Container as Container
from cm.formats.bitstream.container import Image as Image
from cm.formats.bitstream.container import convert as convert
from cm.formats.bitstream.container import open_image as open_image
from cm.formats.bitstream.container import to_dma_words as to_dma_words
from cm.formats.bitstream.errors import BitstreamError as BitstreamError
from cm.formats.bitstream.footprint import footprint_of as footprint_of
from cm.formats.bitstream.footprint import outside as outside
from cm.formats.bitstream.geometry import FrameAddress as FrameAddress
from cm.formats.bitstream.idcodes import Device as Device
from cm.formats.bitstream.idcodes import Family as Family
from cm.formats.bitstream.idcodes import device_by_idcode as device_by_idcode
from cm.formats.bitstream.idcodes import device_by_name as device_by_name
from cm.formats.bitstream.inspect import inspect as inspect
from cm.formats.bitstream.inspection_report import CrcResult as CrcResult
from cm.formats.bitstream.inspection_report import Footprint as Footprint
from cm.formats.bitstream.inspection_report import Refusal as Refusal
from cm.formats.bitstream.inspection_report import Report as Report
from cm.formats.bitstream.report_cache import ReportCache as ReportCache
from cm.formats.bitstream.simulated_module import ModuleIdentity as ModuleIdentity
from cm.formats.bitstream.simulated_module import assemble_module as assemble_module
from cm.formats.bitstream.simulated_module import default_footprint as default_footprint
from cm.formats.bitstream.verify import Expectation as Expectation
from cm.formats.bitstream.verify import expect_module as expect_module
from cm.formats.bitstream.verify import expect_static as expect_static
from cm.formats.bitstream.verify import refusals as refusals
from cm.formats.bitstream.verify import verify as verify
