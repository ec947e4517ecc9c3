"""The commands of ``slippulse``, one module each.

Imports are inside the functions, so that ``--help`` answers at once.
"""

import os
import signal
from typing import Any


def run() -> None:
    """Run ``slippulse``; Ctrl-C ends it without a traceback."""

    def leave(*_: Any) -> None:
        os._exit(130)

    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # from the first import on
        signal.signal(signal.SIGINT, leave)
    from slippulse_jax.cli.main import main

    main()
