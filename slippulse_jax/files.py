"""Atomic writing of files, and reading of those that are not too large."""

import os
import secrets
from pathlib import Path

FIGURE_FORMATS = ("png", "pdf", "svg")
"""Formats in which pictures are written."""


def read_whole(path: str | os.PathLike[str], largest: int) -> bytes:
    """Read a file of at most `largest` bytes, a multiple of 2²⁰; a larger one is a ValueError, without reading it whole."""
    parts, size = [], 0
    with open(path, "rb") as file:
        while part := file.read(2**16):
            parts.append(part)
            size += len(part)
            if size > largest:
                raise ValueError(f"{os.fspath(path)}: larger than {largest >> 20} MiB, the most that is read")
    return b"".join(parts)


def write_atomically(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file atomically.

    `content` goes to a temporary file beside `path`, is flushed to disk and renamed. Whatever interrupts this (a full disk, a
    kill), `path` holds either its former content or all of the new. A link stays a link: the file that it leads to is written.

    Raises
    ------
    OSError
        If the folder does not exist or cannot be written, naming `path`; no temporary file is left.
    """
    target = Path(os.path.realpath(path))
    temporary = target.with_name(f".{target.name[:100]}.{secrets.token_hex(8)}.tmp")
    try:
        # with the usual permissions of the user's files
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, target)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        _flush_folder(target.parent)
    except OSError as error:
        raise type(error)(error.errno, error.strerror, os.fspath(path)) from None


def _flush_folder(folder: Path) -> None:
    """Flush the new name of a file to disk, where the system can."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:  # a folder without permission to read; or Windows
        return
    try:
        os.fsync(handle)
    except OSError:  # not supported by the file system
        pass
    finally:
        os.close(handle)
