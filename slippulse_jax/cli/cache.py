"""Keep compiled programs in the user's cache folder between calls.

Small ones are kept as JAX does, large ones whole. Only the command line does this, and by environment variables that JAX reads
when it is imported later: importing the package changes no setting of JAX.
"""

import hashlib
import itertools
import os
import platform
import shutil
import sys
import time
import traceback
import warnings
from contextlib import suppress
from pathlib import Path

KEPT_DAYS = 60
"""Age at which a program is deleted, as one usually replaced."""
MOST_KEPT = 500
"""Most programs kept, of 100 kB to 2 MB each."""

UNREADABLE = "Error reading persistent compilation cache"


def keep_compiled_programs() -> None:
    """Keep compiled programs in the user's cache folder.

    Without a writable folder JAX compiles each time. A folder that the user has chosen, by JAX_COMPILATION_CACHE_DIR, is left
    to the user's settings.
    """
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    try:
        folder = _folder()
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)  # whatever programs are found there are run
        whole = folder / "whole"
        made = {program: program.stat().st_mtime for program in [*folder.glob("*-*"), *whole.glob("*")]}
        newest = sorted(made, key=made.__getitem__, reverse=True)
        for number, program in enumerate(newest):
            if number >= MOST_KEPT or time.time() - made[program] > KEPT_DAYS * 86400:
                _remove(program)
    except (OSError, RuntimeError):  # no folder, or no home folder to put it in
        return
    if os.access(folder, os.W_OK):
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
        os.environ["SLIPPULSE_PROGRAMS"] = str(whole)
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        # unreadable programs are compiled anew, unwritable ones dropped; the user need not know
        warnings.filterwarnings("always", UNREADABLE)
        warnings.filterwarnings("ignore", "Error writing persistent compilation cache")


def delete_unreadable(warning: Warning | str) -> bool:
    """Delete the program of which JAX warns; return whether it does.

    Call it while JAX handles the error. JAX compiles the program, but would not write over the file, and so would compile it in
    every call.
    """
    folder, failed = os.environ.get("JAX_COMPILATION_CACHE_DIR"), sys.exception()
    if folder is None or folder != str(_folder()) or not str(warning).startswith(UNREADABLE):
        return False
    for frame, _ in traceback.walk_tb(failed and failed.__traceback__):
        if key := frame.f_locals.get("cache_key"):  # the warning does not name it
            with suppress(OSError):
                _remove(Path(folder, f"{key}-cache"))
    return True


def _remove(program: Path) -> None:
    if program.is_dir():
        shutil.rmtree(program)
    else:
        program.unlink(missing_ok=True)


def compile_everything_anew() -> None:
    """Compile everything anew, even where JAX_COMPILATION_CACHE_DIR is set."""
    os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"


def _folder() -> Path:
    """Folder for this user and this kind of processor."""
    if platform.system() == "Windows":
        cache = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif platform.system() == "Darwin":
        cache = Path.home() / "Library" / "Caches"
    else:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    # machines that cannot run each other's code may share a home
    return cache / "slippulse_jax" / hashlib.sha256(_processor().encode()).hexdigest()[:16]


def _processor() -> str:
    """Features of a core that a compiler uses, or the machine's name."""
    kinds = ("vendor_id", "model name", "flags", "CPU implementer", "CPU part", "Features")
    try:
        with Path("/proc/cpuinfo").open(encoding="utf-8") as cores:
            return "".join(line for line in itertools.takewhile(str.strip, cores) if line.startswith(kinds))
    except OSError:
        return f"{platform.node()} {platform.machine()}"
