"""What several test files share: a real browser that complains, and trip records."""

import shutil
from urllib.parse import urlsplit

import numpy as np
import pandas as pd
import pytest
from hypothesis import settings

# A machine that is busy is slow, not wrong; and the same examples each time, because a test that fails by chance tells
# whoever changed something else. New examples are for long runs.
settings.register_profile("steady", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("steady")

HERE = ("127.0.0.1", "localhost", "[::1]", "::1")


@pytest.fixture(scope="session", autouse=True)
def state(tmp_path_factory):
    """A folder for what optkit remembers of its files, in the place of the user's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium, driven by Playwright."""
    api = pytest.importorskip("playwright.sync_api", reason="Playwright is missing: pip install 'optkit[dev]'")
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("Chromium is missing: install your system's package, for example apt-get install chromium")
    # No name but this machine's is found. To intercept what pages ask for would switch their cache off.
    beyond = "--host-resolver-rules=MAP * ~NOTFOUND, " + ", ".join(f"EXCLUDE {host}" for host in HERE)
    with api.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=program, args=["--no-sandbox", beyond])
        yield running
        running.close()


@pytest.fixture(scope="module")
def visit(browser):
    """A browser's visit, whose tabs share what they load, and the list of its complaints, kept by :func:`page`."""
    complaints = []
    context = browser.new_context(viewport={"width": 1280, "height": 800})

    def watch(wanted):
        address = urlsplit(wanted.url)
        if address.scheme in ("http", "https", "ws", "wss") and address.hostname not in HERE:
            complaints.append(f"asks for {wanted.url}")

    context.on("request", watch)
    context.on("page", lambda tab: tab.on("websocket", watch))
    context.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
    context.on("weberror", lambda error: complaints.append(str(error.error)))
    yield context, complaints
    context.close()


@pytest.fixture
def page(visit):
    """A page that may reach this machine only, and fails the test for each console error and each wish to go beyond.

    So do the pages that it opens, all of which are closed at its end.
    """
    context, complaints = visit
    complaints.clear()
    yield context.new_page()
    for tab in context.pages:
        tab.close()
    assert not complaints


@pytest.fixture
def trip_a_minute(tmp_path):
    """Write trip records from Monday, 2018-01-01, 7:00 on, one a minute; return the file."""

    def written(count, minutes=12, pickups=(261,)):
        start = np.datetime64("2018-01-01T07:00") + np.arange(count) * np.timedelta64(1, "m")
        columns = {
            "tpep_pickup_datetime": start,
            "tpep_dropoff_datetime": start + np.timedelta64(minutes, "m"),
            "PULocationID": np.resize(pickups, count),
            "DOLocationID": 236,
        }
        file = tmp_path / "a_tripdata.csv"
        pd.DataFrame(columns).to_csv(file, index=False)
        return file

    return written
