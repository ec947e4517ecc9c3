"""Draw the pictures of the gallery, each by the code above it. Run: python docs/tools/make_gallery.py."""

import re
from typing import Any

from make_pictures import DOCS, save

BLOCK = re.compile(r"^```python\n(.*?)^```$(?:\n\n!\[[^]]*\]\(\.\./pictures/(\w+)\.png\))?", flags=re.M | re.S)


def main() -> None:
    """Draw every picture again."""
    scope: dict[str, Any] = {}
    for code, name in BLOCK.findall((DOCS / "learn" / "gallery.md").read_text("utf-8")):
        exec(code, scope)
        if name:
            save(scope["figure"], name)


if __name__ == "__main__":
    main()
