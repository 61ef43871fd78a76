"""How soon the playground moves, and how many frames a second it draws: `python -m benchmarks.playground`.

Debian's Chromium opens the page from its file, on a desk and on a phone of 360 px whose processor is four times slower.
Beside it, in the same browser, an empty page that does nothing but count its frames: what the browser can do here.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from docs.site.look import PATIENCE, chromium
from playwright.sync_api import Browser
from web import build

SECONDS = 5.0
EMPTY = "data:text/html,<script>const f=()=>requestAnimationFrame(f);f()</script>"
WATCH = """
const frames = (window.frames_ = []), frame = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (draw) => frame((now) => {
  const begin = performance.now();
  draw(now);
  const text = document.getElementById("figures")?.textContent ?? "";
  frames.push([begin, performance.now() - begin, text]);
});
"""
CASES = {
    "desk, 1400 px": ({"width": 1400, "height": 900}, 1),
    "phone, 360 px": ({"width": 360, "height": 740}, 4),
}


def opened(browser: Browser, address: str, window: Any, slower: int) -> list[list[Any]]:
    """Start (ms after the page was asked for), duration (ms) and text of each frame."""
    context = browser.new_context(viewport=window, reduced_motion="no-preference")
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    page.add_init_script(WATCH)
    context.new_cdp_session(page).send("Emulation.setCPUThrottlingRate", {"rate": slower})
    page.goto(address)
    page.wait_for_function("window.frames_.length > 2")
    page.wait_for_timeout(1000 * SECONDS)
    frames: list[list[Any]] = page.evaluate("window.frames_")
    context.close()
    return frames


def per_second(frames: list[list[Any]]) -> float:
    """Frames a second over the last seconds."""
    last = [start for start, _, _ in frames if start > frames[-1][0] - 1000 * (SECONDS - 1)]
    return 1000 * (len(last) - 1) / (last[-1] - last[0])


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        build.write(Path(folder))
        address = (Path(folder) / "playground.html").as_uri()
        print(f"{'':15}  {'moves after':>11}  {'frames':>8}  {'empty page':>10}  {'work of a frame':>20}")
        for name, (window, slower) in CASES.items():
            for motion in ("waves", "scan"):
                state = f"#controller=truestroke&motion={motion}"
                frames, empty = (opened(browser, one, window, slower) for one in (address + state, EMPTY))
                moved = next(end + start for start, end, text in frames if text != frames[0][2])
                work = sorted(end for _, end, _ in frames[len(frames) // 2 :])
                print(
                    f"{name:15}  {moved / 1000:9.2f} s  {per_second(frames):5.1f}/s  {per_second(empty):8.1f}/s  "
                    f"{median(work):5.1f} ms, 95 %: {work[int(0.95 * len(work))]:5.1f} ms  {motion}"
                )


if __name__ == "__main__":
    main()
