# SPDX-License-Identifier: Apache-2.0
"""Debian packages in a separate folder, without root and without changing the machine."""

from cm.design.packages.fetch import PackagesUnavailable as PackagesUnavailable
from cm.design.packages.fetch import PackageTree as PackageTree
from cm.design.packages.fetch import default_folder as default_folder
from cm.design.packages.fetch import fetch as fetch
