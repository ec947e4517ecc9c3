"""Reading files up to a size, writing atomically, values for JSON."""

import math
import os
import secrets
import sys
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

FIGURE_FORMATS = ("png", "pdf", "svg")
"""Formats in which pictures are written."""


def read_whole(path: str | os.PathLike[str], largest: int) -> bytes:
    """Read a file of at most `largest` bytes, a multiple of 2²⁰.

    A larger one is a ValueError, and is not read whole. The path ``-`` is standard input.
    """
    parts, size = [], 0
    with nullcontext(sys.stdin.buffer) if os.fspath(path) == "-" else open(path, "rb") as file:
        while part := file.read(2**16):
            parts.append(part)
            size += len(part)
            if size > largest:
                raise ValueError(f"{file_name(path)}: larger than {largest >> 20} MiB, the most that is read")
    return b"".join(parts)


def file_name(path: str | os.PathLike[str]) -> str:
    """Name of a file that is read, for messages; refuse a text."""
    name = os.fspath(path)
    if len(lines := name.splitlines()) > 1 and not os.path.exists(path):
        raise ValueError(f"{lines[0]!r} …: a text, and no file's name; give its file, or pandas.read_csv(io.StringIO(text))")
    return "standard input" if name == "-" else name


def write_atomically(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file atomically.

    `content` goes to a temporary file beside `path`, is flushed to disk and renamed. Whatever interrupts this (a full disk, a
    kill), `path` holds either its former content or all of the new. A link stays a link: the file that it leads to is written.
    An OSError names `path` if its folder does not exist or cannot be written; no temporary file is left.
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


def shortened(message: str) -> str:
    """Cut out the middle of a long message of a damaged file."""
    return message if len(message) <= 2000 else f"{message[:1400]} … {message[-400:]}"


def plain(content: Any) -> Any:
    """Convert to what JSON takes; numbers that are not finite to None."""
    if isinstance(content, dict):
        return {name: plain(value) for name, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [plain(value) for value in content]
    if names := getattr(getattr(content, "dtype", None), "names", None):
        return [plain(dict(zip(names, row, strict=True))) for row in content.tolist()]
    if hasattr(content, "tolist"):  # an array, or a NumPy scalar
        return plain(content.tolist())
    return None if isinstance(content, float) and not math.isfinite(content) else content
