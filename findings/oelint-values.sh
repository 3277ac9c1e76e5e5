#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a linter's parser of recipes gives a variable the value that BitBake gives it.
# Seen: oelint-parser, below oelint-adv, differs from BitBake 2.19 where defaults are weak, where a variable is used
# before it is set for good, and in overrides: what a linter says of a value may be said of another value.
. "$(dirname "$0")/setup"
pypi oelint-parser==8.13.2 bitbake-setup==2.19.0
mkdir -p hashserv && touch hashserv/__init__.py hashserv/client.py  # the package holds bb, and lacks what bb imports
PYTHONPATH="$PYTHONPATH:$folder" python3 - <<'END'
import os

import bb.data
import bb.parse
import bb.parse.parse_py  # noqa: F401: its handlers register themselves
from oelint_parser.cls_stash import Stash
from saw import saw


def by_bitbake(text):
    open("seen.conf", "w").write(text)
    data = bb.data.init()
    data.setVar("BBPATH", ".")
    return bb.parse.handle("seen.conf", data, True).getVar("A").split()


def by_oelint(text):
    recipe = os.path.abspath("seen_1.0.bb")
    open(recipe, "w").write(text)
    stash = Stash(quiet=True)
    stash.AddFile(recipe)
    stash.Finalize()
    return stash.ExpandVar(filename=recipe, attribute="VarName", attributeValue=["A"])["A"]


for text, theirs, linted in (
    ('A = "x"\nA:append = " y"\nA = "z"\n', ["z", "y"], ["z", "y"]),
    ('A ??= "x"\nA += "y"\n', ["y"], ["x", "y"]),
    ('A ??= "x"\nA ??= "y"\n', ["y"], ["x"]),
    ('B = "x"\nA = "${B}"\nB = "y"\n', ["y"], ["x"]),
    ('OVERRIDES = "q"\nA = "x"\nA:q = "y"\n', ["y"], ["x"]),
):
    saw(f"{text!r}: BitBake, oelint-parser", (by_bitbake(text), by_oelint(text)), (theirs, linted))
END
