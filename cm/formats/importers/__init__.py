# SPDX-License-Identifier: Apache-2.0
"""Packages of other managers as runtime schemas: dfx-mgr (Kria) and PYNQ; and archives of our own build tool.

Nothing of theirs is copied: the schemas point at the package's own files, so that it is loaded in place.
What a package says that the runtime schema cannot express is listed in `Imported.notes`.
"""

from cm.formats.importers.archive import back as back
from cm.formats.importers.archive import unpack as unpack
from cm.formats.importers.blocks import blocks_of as blocks_of
from cm.formats.importers.config_versions import versions as versions
from cm.formats.importers.dfx_mgr import import_dfx_mgr as import_dfx_mgr
from cm.formats.importers.pynq import channel_names as channel_names
from cm.formats.importers.pynq import described_by as described_by
from cm.formats.importers.pynq import import_pynq as import_pynq
from cm.formats.importers.result import Imported as Imported
from cm.formats.importers.result import ImportRefused as ImportRefused
from cm.formats.importers.result import to_name as to_name
from cm.formats.importers.result import write as write
