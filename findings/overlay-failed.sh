#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: an overlay that cannot be applied leaves the tree as it was, so that one may try the next.
# Seen: libfdt wipes the header of both. The tree that was good is no tree any more; only a copy helps.
. "$(dirname "$0")/setup"
pypi pylibfdt==1.7.2.post2
python3 - <<'END'
import libfdt
from saw import saw


def tree(path, target=None):
    made = libfdt.FdtSw()
    made.finish_reservemap()
    with made.add_node(""), made.add_node(path):
        if target:
            made.property_string("target-path", target)
            with made.add_node("__overlay__"):
                pass
    return made.as_fdt()


base, overlay = tree("bus"), tree("fragment@0", "/not-there")
before = bytes(base._fdt[:4]).hex()
saw("applying gives", libfdt.fdt_overlay_apply(base._fdt, overlay._fdt), -libfdt.NOTFOUND)
saw("the base tree began with", before, "d00dfeed")
saw("and begins with now", bytes(base._fdt[:4]).hex(), "ffffffff")
saw("the overlay too", bytes(overlay._fdt[:4]).hex(), "ffffffff")
END
