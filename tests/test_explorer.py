"""Sliders move the model: in this process, and in a real browser where there is one."""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import slippulse_jax as sp

pytest.importorskip("ipywidgets", reason="ipywidgets is not installed")
from slippulse_jax import explorer

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def widget():
    return sp.explore()


def shown_length(text):
    return float(re.search(r"ℓ = ([\d.]+)", text)[1])


def test_it_starts_at_the_papers_slider(widget):
    assert shown_length(widget.numbers.value) == pytest.approx(25.79, abs=0.005)
    assert bytes(widget.picture.value).startswith(b"\x89PNG")
    assert (widget.position.value, widget.position.max) == (26, 26)


def test_everything_follows_without_compiling_again(widget):
    before, compiled = widget.picture.value, explorer.view._cache_size()
    for control, value in (("height", 40.0), ("stiffness", 0.01), ("poisson", 0.2), ("prestress", 0.2), ("slope", 0.001)):
        getattr(widget, control).value = value
        assert widget.picture.value != before
        before = widget.picture.value
    expected = sp.precursor_length(sp.Slider(40.0, 0.01, 0.2), interface=sp.Interface(prestress=0.2, threshold_slope=0.001))
    assert shown_length(widget.numbers.value) == pytest.approx(float(expected), abs=0.0051)
    assert widget.play.max == widget.position.max == int(np.ceil(expected))
    widget.position.value = 3
    assert widget.picture.value != before
    assert explorer.view._cache_size() == compiled


def test_slopes_are_those_of_the_length():
    theta = np.array([25.0, 0.03, 0.3, 0.1, 0.001])
    seen = explorer.view(theta, np.asarray(-1))

    def length(x):
        return sp.precursor_length(sp.Slider(*x[:3]), interface=sp.Interface(prestress=x[3], threshold_slope=x[4]))

    for i, step in enumerate((1e-4, 1e-7, 1e-6, 1e-6, 1e-8)):
        move = step * np.eye(5)[i]
        slope = (length(theta + move) - length(theta - move)) / (2 * step)
        np.testing.assert_allclose(seen.slopes[i], slope, rtol=1e-4)


def test_a_front_that_never_stops_is_said_to(widget):
    widget.slope.value = 0.0
    widget.prestress.value = 0.7
    assert "does not stop" in widget.numbers.value
    assert bytes(widget.picture.value).startswith(b"\x89PNG")
    widget.prestress.value = 0.0


def test_a_dark_page():
    assert bytes(sp.explore(dark=True).picture.value).startswith(b"\x89PNG")


def test_without_ipywidgets_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    with pytest.raises(ImportError, match=r"slippulse_jax\[explore\]"):
        sp.explore()


MISSING = [x for x in ("voila", "selenium") if find_spec(x) is None]
MISSING += [x for x in ("chromium", "chromedriver") if shutil.which(x) is None]


@pytest.fixture
def browser():
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--window-size=1400,900"):
        options.add_argument(argument)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    yield driver
    driver.quit()


@pytest.fixture
def page(tmp_path):
    """Address of a page that shows `explore()`, served by Voilà."""
    import nbformat

    cells = [nbformat.v4.new_code_cell("import slippulse_jax as sp\nsp.explore()")]
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    nbformat.write(nbformat.v4.new_notebook(cells=cells, metadata=kernel), tmp_path / "explore.ipynb")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "voila", "explore.ipynb", "--no-browser", f"--port={port}", "--Voila.ip=127.0.0.1"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with open(tmp_path / "voila.log", "w") as log:
        server = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=log, stderr=log)
    yield f"http://127.0.0.1:{port}/"
    server.terminate()
    server.wait(20)


@pytest.mark.skipif(bool(MISSING), reason=f"no browser test without {', '.join(MISSING)}")
def test_in_a_browser(browser, page, tmp_path):
    """Sliders are moved by keys, and the front is run by the play button."""
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.ui import WebDriverWait

    def wait(condition, seconds=120):
        return WebDriverWait(browser, seconds, poll_frequency=0.2).until(condition)

    def text(_=None):
        found = browser.find_elements(By.CSS_SELECTOR, ".widget-html-content")
        return found[0].text if found else ""

    def picture(_=None):
        return browser.find_element(By.CSS_SELECTOR, "img.widget-image").get_attribute("src")

    deadline = time.monotonic() + 60
    while True:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", int(page.rsplit(":", 1)[1].strip("/")))) == 0:
                break
        assert time.monotonic() < deadline, (tmp_path / "voila.log").read_text()
        time.sleep(0.2)
    browser.get(page)
    wait(lambda _: "ℓ = 25.79" in text())
    handles = browser.find_elements(By.CSS_SELECTOR, ".noUi-handle")
    assert len(handles) == 6
    before = picture()
    handles[0].send_keys(Keys.ARROW_RIGHT)  # height
    wait(lambda _: "ℓ = 25.79" not in text() and picture() != before)
    assert shown_length(text()) == pytest.approx(26.31, abs=0.2)
    # run the front: the count on the slider goes from 0 to the end
    browser.find_element(By.CSS_SELECTOR, ".jupyter-widgets.widget-play button").click()

    def count():
        return int(browser.find_elements(By.CSS_SELECTOR, ".widget-readout")[5].text)

    wait(lambda _: 0 < count() < 20, 30)
    seen = picture()
    wait(lambda _: picture() != seen, 30)
    wait(lambda _: count() >= 26, 60)
    browser.save_screenshot(os.environ.get("EXPLORE_SCREENSHOT", str(tmp_path / "explore.png")))
    errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE" and "favicon" not in entry["message"]]
    assert not [e for e in errors if "widget" in e["message"].lower()], json.dumps(errors)
