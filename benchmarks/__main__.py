"""``python -m benchmarks`` lists the programs here; ``python -m benchmarks NAME …`` runs one, with its own arguments.

``python -m benchmarks NAME --smallest`` takes the arguments SMALLEST of the program instead: all of its paths, at sizes of no meaning.
They need numba, SciPy and lmfit (the extra ``bench``) and, for times that mean something, a machine that does nothing else.
"""

import ast
import runpy
import shlex
import sys
from pathlib import Path

HELPERS = {"__main__", "rivals", "timing"}
PROGRAMS = sorted(path.stem for path in Path(__file__).parent.glob("*.py") if path.stem not in HELPERS)


def smallest(program: str) -> list[str]:
    """Arguments of a program at its smallest size, read without its imports."""
    tree = ast.parse(Path(__file__).with_name(f"{program}.py").read_text(encoding="utf-8"))
    (found,) = (x.value for x in tree.body if isinstance(x, ast.Assign) and ast.unparse(x.targets[0]) == "SMALLEST")
    return shlex.split(ast.literal_eval(found))


def main() -> None:
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name in PROGRAMS:
        sys.argv = [name, *smallest(name)] if sys.argv[2:] == ["--smallest"] else sys.argv[1:]
        runpy.run_module(f"benchmarks.{name}", run_name="__main__")
        return
    for program in PROGRAMS:
        text = Path(__file__).with_name(f"{program}.py").read_text(encoding="utf-8")
        first, _, _ = (ast.get_docstring(ast.parse(text)) or "").partition("\n")
        print(f"{program:18s} {first}")
    if name:
        sys.exit(f"no benchmark {name!r}")


if __name__ == "__main__":
    main()
