# SPDX-License-Identifier: Apache-2.0
"""Debian packages in a separate folder, without root and without changing the machine."""

from cm.build.packages.fetch import PackagesUnavailable as PackagesUnavailable
from cm.build.packages.fetch import default_folder as default_folder
from cm.build.packages.fetch import fetch as fetch
from cm.build.packages.tree import PackageTree as PackageTree
