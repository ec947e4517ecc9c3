"""What the package never does: run text as code, unpickle, start programs, or use the network."""

import ast
import socket
from pathlib import Path

import pytest

import slippulse_jax as sp

PACKAGE = Path(sp.__file__).parent
ROOT = Path(__file__).resolve().parents[2]
MODULES = {
    "cloudpickle", "ctypes", "dill", "ftplib", "http", "joblib", "marshal", "multiprocessing", "pickle", "pty", "requests", "runpy",
    "shelve", "smtplib", "socket", "socketserver", "ssl", "subprocess", "urllib", "urllib3", "webbrowser", "xmlrpc",
}  # fmt: skip
BUILTINS = {"__import__", "breakpoint", "compile", "eval", "exec"}
OF_OS = {"execl", "execv", "execve", "fork", "popen", "posix_spawn", "spawnl", "spawnv", "startfile", "system"}


def unsafe(source):
    """What a module should not do, as (line, name)."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, one.name) for one in node.names if one.name.split(".")[0] in MODULES)
        elif isinstance(node, ast.ImportFrom):
            home = (node.module or "").split(".")[0]
            yield from ((node.lineno, node.module) for _ in [0] if home in MODULES and not node.level)
            yield from ((node.lineno, f"os.{one.name}") for one in node.names if home == "os" and one.name in OF_OS)
        elif isinstance(node, ast.Name) and node.id in BUILTINS:
            yield node.lineno, node.id
        elif (
            isinstance(node, ast.Attribute)
            and node.attr in OF_OS
            and isinstance(node.value, ast.Name)
            and node.value.id == "os"
        ):
            yield node.lineno, f"os.{node.attr}"
        elif isinstance(node, ast.keyword) and node.arg == "allow_pickle":
            yield node.value.lineno, "allow_pickle"


def test_such_a_module_is_found():
    source = "import pickle, os\nfrom urllib.request import urlopen\nfrom os import system\nos.popen('')\neval('1')\nload(allow_pickle=True)"
    assert [name for _, name in sorted(unsafe(source))] == [
        "pickle", "urllib.request", "os.system", "os.popen", "eval", "allow_pickle",
    ]  # fmt: skip


def test_no_module_does():
    paths = sorted(PACKAGE.rglob("*.py"))
    assert len(paths) > 100
    found = {f"{path.relative_to(PACKAGE)}:{line}": name for path in paths for line, name in unsafe(path.read_text("utf-8"))}
    assert found == {}


@pytest.mark.ci
def test_a_fit_and_a_sweep_use_no_network(monkeypatch, tmp_path):
    def forbidden(*_, **__):
        raise AssertionError("the network was used")

    monkeypatch.setattr(socket, "getaddrinfo", forbidden)
    for name in ("bind", "connect", "connect_ex", "sendto"):  # a pair of sockets within the process, as asyncio has, is none
        monkeypatch.setattr(socket.socket, name, forbidden)
    with pytest.raises(AssertionError, match="network"), socket.socket() as one:
        one.connect(("127.0.0.1", 9))
    assert sp.fit(ROOT / "fit_examples" / "pmma_block" / "lengths.csv").values["areal_stiffness"] > 0
    found = sp.sweep(height=[20.0, 30.0], stiffness=0.03, poisson=0.3, outputs="length", store=tmp_path / "store")
    assert found.length.values.min() > 0
