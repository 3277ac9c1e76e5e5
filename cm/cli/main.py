# SPDX-License-Identifier: Apache-2.0
"""The command `cm`. All else is imported when it has begun, so that Ctrl-C ends it quietly from its first moment on."""

from __future__ import annotations

import sys
from collections.abc import Sequence

_INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `cm` with `arguments` (default: those of the process); the exit status (`cm.cli.dispatch`).

    Wrong usage ends in SystemExit(2), as argparse has it.
    """
    try:
        import signal

        if arguments is None and signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # `cm.child` has begun so
            signal.signal(signal.SIGINT, signal.default_int_handler)
        from cm.cli.dispatch import run
    except KeyboardInterrupt:
        return _INTERRUPTED
    return run(arguments)


if __name__ == "__main__":
    sys.exit(main())
