"""Results as plain Python values, for JSON and the next program."""

import math
from typing import Any


def plain(content: Any) -> Any:
    """The same with arrays and tuples as lists, and None for every number that is not finite: JSON has no word for it."""
    if isinstance(content, dict):
        return {name: plain(value) for name, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [plain(value) for value in content]
    if hasattr(content, "tolist"):  # an array, or a number of NumPy's
        return plain(content.tolist())
    return None if isinstance(content, float) and not math.isfinite(content) else content
