"""Open the site in Chromium: `python -m docs.site.look FOLDER [PAGE...]`. It ends with 1, and what is wrong.

Each page, or those that are named, at three widths, light and dark, with and without reduced motion, on screen and
printed: nothing on the console, no request to a network, nothing wider than the page, and no violation that axe-core
finds of WCAG 2 A and AA, contrast among them, on a phone and at a desk. `python -m docs.site.look --pdf FILE PAGE`
prints a page.
"""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, sync_playwright

WIDTHS = (360, 800, 1400)  # px: phone, tablet, desk
PAPER = 700  # px: A4 within its margins
BATCH = 12  # pages that share a browser: of a hundred in one, Chromium ended before the last
SMALLER = 0.8  # of the letters on the screen, on paper
PATIENCE = 120_000  # ms, of a busy machine
FLAGS = ("--no-sandbox", "--disable-dev-shm-usage")  # as root, and in a container
RULES = {  # to describe the elements that pass takes half of the time; a file may neither preload nor frame
    "runOnly": ["wcag2a", "wcag2aa"],
    "resultTypes": ["violations"],
    "preload": False,
    "iframes": False,
}
SCHEMES, MOTIONS = ("light", "dark"), ("no-preference", "reduce")


@contextmanager
def chromium() -> Iterator[Browser]:
    """Debian's browser: playwright's own is another download."""
    place = shutil.which("chromium")
    if not place:
        raise FileNotFoundError("no chromium on this computer; to install it: sudo apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=place, args=FLAGS, timeout=PATIENCE)
        yield browser
        browser.close()


@contextmanager
def listening(page: Page, wrong: list[str]) -> Iterator[None]:
    """Collect what the page says on the console, and what it asks of a network."""

    def requested(request: Any) -> None:
        if not request.url.startswith(("file:", "data:", "blob:")):
            wrong.append(f"asks for {request.url}")

    page.on("request", requested)
    page.on("pageerror", lambda error: wrong.append(f"raises {error}"))
    page.on("console", lambda message: wrong.append(f"console: {message.text}") if message.type != "log" else None)
    yield


def too_wide(page: Page) -> list[str]:
    """The words for a page that scrolls sideways, when its charts have taken the width of the window."""
    page.evaluate("new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
    wide, window = page.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
    return [f"{wide} px wide in a window of {window} px"] if wide > window else []


def marked(page: Page) -> set[str]:
    """The colours of the markers in the legends of its charts, as "#rrggbb"."""
    found = page.eval_on_selector_all(
        ".u-marker", "all => all.filter(one => one.offsetWidth).map(one => getComputedStyle(one).borderTopColor)"
    )
    return {"#" + "".join(f"{int(part):02x}" for part in re.findall(r"\d+", colour)[:3]) for colour in found}


def inaccessible(page: Page, scheme: str = "light") -> list[str]:
    """What axe-core finds; in the dark only colours can differ."""
    rules = RULES if scheme == "light" else {**RULES, "runOnly": ["color-contrast"]}
    found = Axe().run(page, options=rules).response["violations"]
    return [f"{rule['id']}: {node['html'][:160]}" for rule in found for node in rule["nodes"][:3]]


def look(browser: Browser, file: Path) -> list[str]:
    """What is wrong with a page, which is opened once: all else is switched in place."""
    wrong: list[str] = []
    context = browser.new_context(color_scheme="light", reduced_motion="no-preference")
    context.set_default_timeout(PATIENCE)
    page = context.new_page()
    with listening(page, wrong):
        page.goto(file.as_uri())
        for width in WIDTHS:
            page.set_viewport_size({"width": width, "height": 900})
            for scheme, motion in product(SCHEMES, MOTIONS):
                page.emulate_media(color_scheme=scheme, reduced_motion=motion)
                wrong += [f"{scheme}, {motion}: {words}" for words in too_wide(page)]
            if width != WIDTHS[1]:  # where no element is shown that the other two do not have
                for scheme in SCHEMES:
                    page.emulate_media(color_scheme=scheme)
                    wrong += [f"{scheme}, {width} px: {words}" for words in inaccessible(page, scheme)]
        page.set_viewport_size({"width": PAPER, "height": 900})
        for scheme in SCHEMES:
            page.emulate_media(media="print", color_scheme=scheme)
            wrong += [f"{scheme}, printed: {words}" for words in too_wide(page)]
    context.close()
    return [f"{file.name}: {words}" for words in wrong]


def look_at(files: list[Path]) -> list[str]:
    """What is wrong with the pages; it is also printed as it is found, for all of them take minutes."""
    wrong: list[str] = []
    for first in range(0, len(files), BATCH):
        with chromium() as browser:
            for number, file in enumerate(files[first : first + BATCH], start=first + 1):
                found = look(browser, file)
                print(f"{number} of {len(files)}: {file.name}", *found, sep="\n  ", flush=True)
                wrong += found
    return wrong


def printed(page: Path, file: Path) -> None:
    """The page as a PDF, with numbers on its sheets."""
    foot = '<div style="font-size: 8px; width: 100%; text-align: center"><span class="pageNumber"></span></div>'
    margin = {"top": "18mm", "bottom": "18mm", "left": "16mm", "right": "16mm"}
    with chromium() as browser:
        sheet = browser.new_page(color_scheme="light")
        sheet.goto(page.resolve().as_uri(), timeout=PATIENCE)
        sheet.pdf(
            path=file,
            format="A4",
            scale=SMALLER,
            margin=margin,
            display_header_footer=True,
            header_template="<span></span>",
            footer_template=foot,
            outline=True,
            tagged=True,
        )


def main(*arguments: str) -> list[str]:
    """Look, or print."""
    if arguments[0] == "--pdf":
        printed(Path(arguments[2]), Path(arguments[1]))
        return []
    folder = Path(arguments[0]).resolve()
    return look_at([folder / name for name in arguments[1:]] or sorted(folder.rglob("*.html")))


if __name__ == "__main__":
    sys.exit("\n".join(main(*sys.argv[1:])) or 0)
