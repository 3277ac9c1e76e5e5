# SPDX-License-Identifier: Apache-2.0
"""`cm web`: a page to look at a board through, and with `--control` to change it. It is a client like any other."""
