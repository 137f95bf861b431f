"""What several test files share: a real browser that complains."""

import shutil
from urllib.parse import urlsplit

import pytest

HERE = ("127.0.0.1", "localhost", "[::1]", "::1")


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium, driven by Playwright."""
    api = pytest.importorskip("playwright.sync_api", reason="Playwright is missing: pip install 'optkit[dev]'")
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("Chromium is missing: install your system's package, for example apt-get install chromium")
    with api.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield running
        running.close()


@pytest.fixture
def page(browser):
    """A page that may reach this machine only, and fails the test for each console error and each wish to go beyond."""
    complaints = []
    context = browser.new_context(viewport={"width": 1280, "height": 800})

    def watch(route, request):
        address = urlsplit(request.url)
        if address.scheme in ("http", "https", "ws", "wss") and address.hostname not in HERE:
            complaints.append(f"asks for {request.url}")
            route.abort()
        else:
            route.continue_()

    context.route("**/*", watch)
    tab = context.new_page()
    tab.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    yield tab
    context.close()
    assert not complaints
