"""`plot.explore()` as a reader meets it: in JupyterLab, in a real browser, moved by keys and by the play button."""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

import slippulse_jax as sp

ROOT = Path(__file__).resolve().parents[2]
TOKEN = "slippulse"
# the one thing that the extra `ci` cannot install; a package of it that is missing is a failure, not a reason to skip
MISSING = [x for x in ("chromium", "chromedriver") if shutil.which(x) is None]
pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(bool(MISSING), reason=f"no browser on this machine: {', '.join(MISSING)} not found"),
]


@pytest.fixture
def address(tmp_path):
    """Address of a notebook of one cell, in a JupyterLab that knows no one's settings."""
    import nbformat

    cells = [nbformat.v4.new_code_cell("import slippulse_jax as sp\nsp.plot.explore()")]
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    work = tmp_path / "work"
    work.mkdir()
    nbformat.write(nbformat.v4.new_notebook(cells=cells, metadata=kernel), work / "explore.ipynb")
    settings = tmp_path / "settings" / "@jupyterlab" / "apputils-extension"
    settings.mkdir(parents=True)
    (settings / "notification.jupyterlab-settings").write_text('{"fetchNews": "false", "checkForUpdates": false}')
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    folders = {f"JUPYTER_{name}_DIR": str(tmp_path / name.lower()) for name in ("CONFIG", "DATA", "RUNTIME")}
    folders |= {
        "JUPYTERLAB_SETTINGS_DIR": str(tmp_path / "settings"),
        "JUPYTERLAB_WORKSPACES_DIR": str(tmp_path / "workspaces"),
    }
    command = [sys.executable, "-m", "jupyterlab", "--no-browser", "--ip=127.0.0.1", f"--port={port}", "--allow-root"]
    command += ["--ServerApp.port_retries=0", f"--IdentityProvider.token={TOKEN}", f"--ServerApp.root_dir={work}"]
    with open(tmp_path / "server.log", "w") as log:
        server = subprocess.Popen(
            command, cwd=work, env=os.environ | folders | {"PYTHONPATH": str(ROOT)}, stdout=log, stderr=log
        )
    try:
        wait_until_it_answers(f"http://127.0.0.1:{port}/api/status?token={TOKEN}", server, tmp_path / "server.log")
        yield f"http://127.0.0.1:{port}/lab/tree/explore.ipynb?token={TOKEN}"
    finally:
        server.terminate()
        server.wait(30)


def wait_until_it_answers(address, server, log):
    deadline = time.monotonic() + 90
    while True:
        try:
            urllib.request.urlopen(address, timeout=10).read()
            return
        except OSError:
            assert server.poll() is None, log.read_text()
            assert time.monotonic() < deadline, log.read_text()
            time.sleep(0.2)


@pytest.fixture
def browser(tmp_path):
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for argument in (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        "--window-size=1500,1150",
        f"--user-data-dir={tmp_path / 'profile'}",
    ):
        options.add_argument(argument)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    yield driver
    driver.quit()


def test_sliders_and_play_button_in_jupyterlab(browser, address, tmp_path):
    """The cell is run, sliders are moved by keys, and the front is run by the play button."""
    from selenium.common.exceptions import StaleElementReferenceException, WebDriverException
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.ui import WebDriverWait

    def wait(condition, seconds=120):
        ignored = [StaleElementReferenceException, WebDriverException]
        return WebDriverWait(browser, seconds, poll_frequency=0.2, ignored_exceptions=ignored).until(condition)

    def find(css):
        return browser.find_elements(By.CSS_SELECTOR, css)

    def numbers():
        found = find(".widget-html-content")
        return found[0].text if found else ""

    def picture():
        return find("img.widget-image")[0].get_attribute("src")

    def count():
        return int(find(".widget-readout")[5].text)

    def shot(name):
        folder = Path(os.environ.get("SCREENSHOTS", tmp_path))
        assert browser.save_screenshot(str(folder / f"jupyterlab_{name}.png"))

    def run_cell():
        """By Shift-Enter; keys that the page loses while it is busy are pressed again."""
        find(".jp-CodeCell .cm-content")[0].click()
        ActionChains(browser).key_down(Keys.SHIFT).send_keys(Keys.ENTER).key_up(Keys.SHIFT).perform()
        return wait(lambda _: re.search(r"\[[*1]\]", find(".jp-InputPrompt")[0].text), 20)

    browser.get(address)
    wait(
        lambda _: find(".jp-Notebook .jp-CodeCell .cm-content") and find(".jp-Notebook-ExecutionIndicator[data-status='idle']")
    )
    wait(lambda _: run_cell())
    wait(lambda _: "ℓ = 25.79" in numbers())

    handles = find(".noUi-handle")
    assert len(handles) == 6
    before = picture()

    def moved():
        """Height, by one step of 0.5; a key that the page or the kernel loses while it is busy is pressed again."""
        find(".noUi-handle")[0].send_keys(Keys.ARROW_RIGHT)
        return wait(lambda _: "ℓ = 25.79" not in numbers() and picture() != before, 20)

    wait(lambda _: moved())
    slider = sp.Slider(float(find(".widget-readout")[0].text), 0.03, 0.3)
    assert slider.height in (25.5, 26.0, 26.5)
    expected, end = float(sp.precursor_length(slider)), int(sp.first_precursor(slider).contacts_broken)
    wait(lambda _: abs(float(re.search(r"ℓ = ([\d.]+)", numbers())[1]) - expected) < 0.006)

    # what the kernel sends after the picture: the new end, which would stop a front that runs already
    wait(lambda _: count() == end, 30)

    # run the front: the count on the last slider goes from 0 to the end, and the picture follows
    find(".jupyter-widgets.widget-play button")[0].click()
    wait(lambda _: count() < end, 30)
    seen = picture()
    shot("running")
    wait(lambda _: picture() != seen, 30)
    wait(lambda _: count() == end, 60)
    shot("stopped")
    errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert not [e for e in errors if "widget" in e["message"].lower()], json.dumps(errors)
