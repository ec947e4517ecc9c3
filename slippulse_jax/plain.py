"""Results as plain Python values, for JSON."""

import math
from typing import Any


def plain(content: Any) -> Any:
    """Convert arrays and tuples to lists, and numbers that are not finite to None, for which JSON has no other word."""
    if isinstance(content, dict):
        return {name: plain(value) for name, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [plain(value) for value in content]
    if hasattr(content, "tolist"):  # an array, or a number of NumPy's
        return plain(content.tolist())
    return None if isinstance(content, float) and not math.isfinite(content) else content
