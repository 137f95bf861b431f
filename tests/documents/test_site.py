"""The documentation site builds strictly, its links lead somewhere, and its pages need nothing from elsewhere."""

import gc
import io
import re
import sys
import warnings
from contextlib import redirect_stderr
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

DOCS = Path(__file__).parents[2] / "docs"

pytestmark = pytest.mark.slow  # whichever is first, builds the site


class Page(HTMLParser):
    """What a page links to, loads and can be jumped to."""

    def __init__(self, path):
        super().__init__()
        self.links, self.loads, self.anchors, self.formulas = [], [], {"", "top"}, 0
        self.feed(path.read_text())

    def handle_starttag(self, tag, attributes):
        """Take note of a tag."""
        given = dict(attributes)
        self.anchors |= {given[key] for key in ("id", "name") if given.get(key)}
        self.formulas += tag == "math"
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        elif tag == "link" and given.get("href"):
            self.loads.append(given["href"])
        elif given.get("src"):
            self.loads.append(given["src"])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build the site once, warnings being errors, and return its folder."""
    for needed in ("sphinx", "furo", "myst_parser", "numpydoc"):
        pytest.importorskip(needed, reason=f"{needed} is missing: pip install 'optkit[docs]'")
    from sphinx.cmd.build import build_main

    place = tmp_path_factory.mktemp("site")
    options = ["-W", "--keep-going", "-q", "-b", "html", "-d", str(place / "doctrees")]
    told, collecting, path = io.StringIO(), gc.isenabled(), sys.path[:]
    try:  # as sphinx-build does, but in this process, which has imported already what is documented
        with redirect_stderr(told), warnings.catch_warnings(record=True) as warned:
            for hidden in (DeprecationWarning, PendingDeprecationWarning):  # as Python does outside of tests
                warnings.simplefilter("ignore", hidden)
            done = build_main([*options, str(DOCS), str(place / "html")])
    finally:
        sys.path[:] = path
        if collecting:
            gc.enable()
    assert done == 0, told.getvalue()
    assert not told.getvalue(), told.getvalue()
    assert not warned, [str(one.message) for one in warned]
    return place / "html"


@pytest.fixture(scope="module")
def pages(site):
    """All pages by their path."""
    return {path: Page(path) for path in sorted(site.rglob("*.html"))}


@pytest.mark.slow
def test_every_source_became_a_page(site):
    """No page of the sources is left out, and none of the build's own files is taken for one."""
    sources = {p.relative_to(DOCS).with_suffix("") for p in DOCS.rglob("*.md") if "_build" not in p.parts}
    sources |= {p.relative_to(DOCS).with_suffix("") for p in DOCS.rglob("*.rst") if "_build" not in p.parts}
    built = {p.relative_to(site).with_suffix("") for p in site.rglob("*.html")}
    assert built - sources == {Path("search"), Path("genindex"), Path("py-modindex")}
    assert sources <= built


@pytest.mark.slow
def test_links_and_anchors_lead_somewhere(site, pages):
    """Every link within the site has a target, with the anchor that it names; links beyond are well formed."""
    within = 0
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                assert parts.scheme == "https", f"{path.name}: {link}"
                assert re.fullmatch(r"[a-z0-9-]+(\.[a-z0-9-]+)+", parts.hostname), f"{path.name}: {link}"
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert target.is_file(), f"{path.relative_to(site)}: {link}"
            if target in pages:
                assert unquote(parts.fragment) in pages[target].anchors, f"{path.relative_to(site)}: {link}"
            within += 1
    assert within > 1000


def test_pages_load_nothing_from_elsewhere(site, pages):
    """Scripts, styles, pictures and fonts lie within the site."""
    for path, page in pages.items():
        for wanted in page.loads:
            parts = urlsplit(wanted)
            assert parts.scheme in ("", "data"), f"{path.name}: {wanted}"
            assert parts.scheme or not parts.netloc, f"{path.name}: {wanted}"
            assert parts.scheme or parts.path == "#" or (path.parent / unquote(parts.path)).exists(), wanted
    for style in site.rglob("*.css"):
        for target in re.findall(r"(?:url\(|@import\s*)[\"']?([^\"')\s]+)", style.read_text()):
            assert not re.match(r"(https?:)?//", target), f"{style.name}: {target}"


def test_formulas_are_written_out(site, pages):
    """Every dollar sign of the sources became MathML, and no TeX is left."""
    assert sum(page.formulas for page in pages.values()) > 150
    for path in pages:
        for formula in re.findall(r"<math.*?</math>", path.read_text(), re.S):
            bare = re.sub(r"<[^>]+>", "", formula)
            assert "\\" not in bare, f"{path.name}: {bare}"
            assert "merror" not in formula, f"{path.name}: {bare}"


LOOK = """
document.fonts.ready.then(() => {
    const box = document.querySelector('h1')?.getBoundingClientRect();
    return {
        width: document.documentElement.scrollWidth,
        title: Boolean(box && box.width && box.height && document.querySelector('h1').checkVisibility(
            {visibilityProperty: true})),
        background: getComputedStyle(document.body).backgroundColor,
    };
})
"""
"""How wide a page is, whether its first title is seen, and its colour, once its fonts are there."""


@pytest.mark.slow
def test_pages_show_well(site, pages, page):
    """Every page asks for nothing beyond this machine, complains nowhere, and fits a desk and a dark phone."""
    looks = [(1280, "light"), (390, "dark")]
    for path in pages:
        for turn, (width, scheme) in enumerate(looks):
            page.set_viewport_size({"width": width, "height": 844})
            page.emulate_media(color_scheme=scheme)
            if turn == 0:
                page.goto(path.as_uri())
            seen = page.evaluate(LOOK)
            assert seen["width"] <= width, path.relative_to(site)
            if path.name != "search.html":  # which has one only once it has found something
                assert seen["title"], path.relative_to(site)
            dark = sum(int(part) for part in re.findall(r"\d+", seen["background"])[:3]) < 3 * 128
            assert dark == (scheme == "dark"), path.relative_to(site)
        looks.reverse()  # the next page begins as this one ended: to change a look is what takes time


def test_formulas_are_seen(site, page):
    """Formulas have a size, and are set in the font that the site brings; a wide one scrolls within its box."""
    page.set_viewport_size({"width": 390, "height": 844})
    page.goto((site / "explanation" / "pricing.html").as_uri())
    page.evaluate("document.fonts.ready")
    loaded = page.evaluate("[...document.fonts].filter(font => font.status === 'loaded').map(font => font.family)")
    assert any("Formulas" in family for family in loaded)
    boxes = page.locator("div.math")
    sizes = [boxes.nth(k).bounding_box() for k in range(boxes.count())]
    assert len(sizes) >= 10
    assert all(box["height"] > 15 and box["width"] <= 390 for box in sizes)
    fraction = page.locator("mfrac").first.bounding_box()
    assert fraction["height"] > 15


@pytest.mark.slow
def test_search_finds_a_word_without_a_server(site, page):
    """The site's own search works from the file system."""
    page.goto((site / "search.html").as_uri() + "?q=markup")
    page.wait_for_selector("ul.search li a")
    assert "markup" in page.locator("ul.search").inner_text().lower()
