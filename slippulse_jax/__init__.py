"""Self-healing slip pulses at the onset of sliding: a differentiable model.

The public names are listed once, in ``__init__.pyi``, and imported when first used, so that ``slippulse --help`` answers
without starting JAX.
"""

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

_MODULE_OF = {
    name.name: statement.module
    for statement in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(statement, ast.ImportFrom) and statement.module
    for name in statement.names
}

__all__ = [*_MODULE_OF, "__version__"]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("slippulse_jax")
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'slippulse_jax' has no attribute {name!r}")
    module = _MODULE_OF[name]
    if module == __name__:
        return import_module(f"{module}.{name}")
    return getattr(import_module(module), name)


def __dir__() -> list[str]:
    return sorted(__all__)
