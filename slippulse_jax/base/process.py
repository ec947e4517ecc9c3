"""Whether JAX can compute in this process."""

import os
import sys

_forked = False


def _note_fork() -> None:
    global _forked
    _forked = bool(getattr(sys.modules.get("jax._src.xla_bridge"), "_backends", None))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)


def check_process() -> None:
    """Check that JAX can compute in this process.

    In a child of ``fork`` of a process that had used JAX it would wait for ever. A RuntimeError says how to start workers
    instead.
    """
    if _forked:
        raise RuntimeError(
            "this process was forked from one that had used JAX, whose threads it lacks, so it would wait for ever: start "
            'workers with multiprocessing.get_context("spawn"), or before anything is computed'
        )
