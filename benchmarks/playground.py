"""How soon the playground moves, and what a frame of it costs: `python -m benchmarks.playground`.

Debian's Chromium opens the page from its file, at three widths, and as a phone whose processor is four times slower.
The work of a frame is the processor time of the browser, of script and of drawing, over the frames that it drew: other
programs on the computer make frames late, but their time is not in it. Chromium draws without a graphics processor.
Beside it, in the same browser, an empty page that does nothing but count its frames: what the browser can do here.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from docs.site.look import PATIENCE, chromium
from playwright.sync_api import Browser
from web import build

SECONDS = 5.0
MOTIONS = ("waves", "sine", "scan")
EMPTY = "data:text/html,<script>const f=()=>requestAnimationFrame(f);f()</script>"
WATCH = """
const frames = (window.frames_ = []), frame = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (draw) => frame((now) => {
  draw(now);
  const text = document.getElementById("figures")?.textContent ?? "";
  frames.push([performance.now(), text]);
});
"""
PHONE = {"viewport": {"width": 360, "height": 740}, "device_scale_factor": 2}
CASES: dict[str, tuple[dict[str, Any], int]] = {
    "360 px": (PHONE, 1),
    "768 px": ({"viewport": {"width": 768, "height": 1024}}, 1),
    "1280 px": ({"viewport": {"width": 1280, "height": 900}}, 1),
    "360 px, slow": (PHONE, 4),
}


class Opened(NamedTuple):
    """What one opening of a page showed."""

    moves: float  # s after the page was asked for
    frames: float  # a second
    script: float  # ms of a frame, of the clock on the wall
    work: float  # ms of a frame, of processor time: script and drawing, in all processes of the browser


def opened(browser: Browser, address: str, window: dict[str, Any], slower: int) -> Opened:
    """Open a page in a window and let it move for a while."""
    context = browser.new_context(**window, reduced_motion="no-preference")
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    page.add_init_script(WATCH)
    browser_session, session = browser.new_browser_cdp_session(), context.new_cdp_session(page)
    session.send("Emulation.setCPUThrottlingRate", {"rate": slower})
    session.send("Performance.enable")

    def spent() -> tuple[int, float, float]:
        """Frames so far, and s of processor and script."""
        processes = browser_session.send("SystemInfo.getProcessInfo")["processInfo"]
        metrics = {entry["name"]: entry["value"] for entry in session.send("Performance.getMetrics")["metrics"]}
        processor = sum(process["cpuTime"] for process in processes)
        return page.evaluate("window.frames_.length"), processor, metrics["ScriptDuration"]

    page.goto(address)
    page.wait_for_function("window.frames_.length > 2")
    page.wait_for_timeout(2000)  # compiled, laid out
    first = spent()
    page.wait_for_timeout(1000 * SECONDS)
    last = spent()
    frames: list[tuple[float, str]] = page.evaluate("window.frames_")
    context.close()
    number, processor, script = (end - begin for begin, end in zip(first, last, strict=True))
    moves = next((at for at, text in frames if text != frames[0][1]), 0.0)
    seconds = (frames[last[0] - 1][0] - frames[first[0] - 1][0]) / 1000
    return Opened(moves / 1000, number / seconds, 1000 * script / number, 1000 * processor / number)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        build.write(Path(folder))
        address = (Path(folder) / "playground.html").as_uri()
        print(f"{'':20}  {'moves after':>11}  {'frames':>8}  {'script':>8}  {'script and drawing':>18}")
        for name, (window, slower) in CASES.items():
            pages = {motion: f"{address}#controller=truestroke&motion={motion}" for motion in MOTIONS}
            for motion, page in {**pages, "empty page": EMPTY}.items():
                one = opened(browser, page, window, slower)
                work = f"{one.work:15.1f} ms" if slower == 1 else "-"  # what slows it down takes time itself
                print(
                    f"{name:13} {motion:10}  {one.moves:5.2f} s  {one.frames:5.1f}/s  {one.script:5.1f} ms  {work:>18}",
                    flush=True,
                )
        print(f"load of the computer, over its {os.cpu_count()} cores: {os.getloadavg()[0]:.0f}")


if __name__ == "__main__":
    main()
