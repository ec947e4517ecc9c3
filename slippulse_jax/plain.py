"""Results as plain Python values, for JSON, and messages of a length to be read."""

import math
from typing import Any


def shortened(message: str) -> str:
    """Leave out the middle of a long message: a damaged file may hold a cell of megabytes."""
    return message if len(message) <= 2000 else f"{message[:1400]} … {message[-400:]}"


def plain(content: Any) -> Any:
    """Convert arrays and tuples to lists, and numbers that are not finite to None, for which JSON has no other word."""
    if isinstance(content, dict):
        return {name: plain(value) for name, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [plain(value) for value in content]
    if hasattr(content, "tolist"):  # an array, or a number of NumPy's
        return plain(content.tolist())
    return None if isinstance(content, float) and not math.isfinite(content) else content
