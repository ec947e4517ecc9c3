"""Results as plain Python values, for JSON, and messages of a length to be read."""

import math
from typing import Any


def shortened(message: str) -> str:
    """Cut out the middle of a long message, since a damaged file may have a cell of megabytes."""
    return message if len(message) <= 2000 else f"{message[:1400]} … {message[-400:]}"


def plain(content: Any) -> Any:
    """Convert arrays and tuples to lists, and numbers that are not finite to None, as JSON needs."""
    if isinstance(content, dict):
        return {name: plain(value) for name, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [plain(value) for value in content]
    if hasattr(content, "tolist"):  # an array, or a NumPy scalar
        return plain(content.tolist())
    return None if isinstance(content, float) and not math.isfinite(content) else content
