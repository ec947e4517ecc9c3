"""Atomic writing of files."""

import os
import tempfile
from pathlib import Path


def write_atomically(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file whole or not at all.

    `content` goes to a temporary file beside `path`, is flushed to disk and renamed. Whatever interrupts this (a full disk, a
    kill), `path` holds either its former content or all of the new.

    Raises
    ------
    OSError
        If the folder does not exist or cannot be written; no temporary file is left.
    """
    path = Path(path)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        # mkstemp makes files private; a result should have the permissions the user's other files get
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
