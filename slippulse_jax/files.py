"""Atomic writing of files, and reading of those that are not too large."""

import os
import secrets
from contextlib import suppress
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
        with open(temporary, "xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except OSError as error:
        raise type(error)(error.errno, error.strerror, os.fspath(path)) from None
    finally:
        with suppress(OSError):
            temporary.unlink()
