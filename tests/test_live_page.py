"""The live page of a run: what it shows, who may change what, and that STOP works whatever its readers do."""

from __future__ import annotations

import contextlib
import http.client
import json
import re
import selectors
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from docs.site import look
from running import COMMAND

from truestroke import Recording, SettingError, StoppedError
from truestroke.cli import main
from truestroke.report.style import THEMES
from truestroke.runtime.drivers.guard import Limits
from truestroke.runtime.drivers.playback import lead, playback
from truestroke.runtime.drivers.simulated import SimulatedDriver
from truestroke.runtime.realtime import LiveSettings, RealtimeError, config, server
from truestroke.runtime.realtime.live_page import access, door, frames, relay
from truestroke.runtime.realtime.live_page.orders import Orders
from truestroke.runtime.realtime.server import Panel
from truestroke.runtime.realtime.shared import FIELDS, Helper, Layout, Shared, Slot, State
from truestroke.runtime.realtime.watched import Watched
from truestroke.signals.channels import Channel

CONTROL, READING = "control-" * 3, "reading-" * 3
TABLES = f'\n[live]\nport = 0\ncontrol = "{CONTROL}"\nreading = "{READING}"\n'
HANGING = f"GET /stream HTTP/1.1\r\nHost: 127.0.0.1:{{}}\r\nAuthorization: Bearer {READING}\r\n\r\n"


class Served:
    """A command with a live page of these tokens."""

    def __init__(self, folder: Path, *command: str) -> None:
        pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen([COMMAND, *command], cwd=folder, **pipes)
        assert self.process.stderr
        address = self.process.stderr.readline()
        found = re.search(r"http://127\.0\.0\.1:(\d+)/#" + CONTROL, address)
        assert found, address + self.process.stderr.read()
        self.port = int(found[1])
        self.address = f"http://127.0.0.1:{self.port}/"

    def ask(self, method: str, path: str, body: bytes | None = None, **headers: str) -> tuple[int, bytes, Any]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)
        connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        return answer.status, content, answer.headers

    def do(self, token: str = CONTROL, origin: str | None = None, **what: Any) -> int:
        headers = {"Authorization": f"Bearer {token}"} | ({"Origin": origin} if origin else {})
        return self.ask("POST", "/do", json.dumps(what).encode(), **headers)[0]

    def frames(self) -> Iterator[dict[str, Any]]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)
        connection.request("GET", "/stream", headers={"Authorization": f"Bearer {READING}"})
        answer = connection.getresponse()
        try:
            while line := answer.readline():
                yield json.loads(line)
        finally:
            connection.close()

    def until(self, true: Any) -> dict[str, Any]:
        """The first frame of which that is true."""
        for frame in self.frames():
            if "state" in frame and true(frame):
                return frame
        raise AssertionError("the stream ended")


def serving(duration: float) -> str:
    """The example of `serve` with a live page, for so many seconds."""
    text = config.example("serve").replace("= 3600.0", f"= {duration}").partition("\n[epics]")[0]
    text = re.sub(r"overrun_streak = \d+", "", text).partition("\n[realtime]")[0].partition("\n[recording]")[0]
    realtime = "[realtime]\nspin = 0.0\noverrun_streak = 0\nwatchdog_timeout = 20.0\n"
    return f'{text}\n{realtime}[recording]\nfile = "run.h5"\n{TABLES}'


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Served, Path]]:
    folder = tmp_path_factory.mktemp("live")
    (folder / "serve.toml").write_text(serving(300.0))
    served = Served(folder, "serve", "--live", "--config", "serve.toml", "--json")
    try:
        yield served, folder
    finally:
        served.process.kill()
        served.process.communicate()


def test_a_run_is_watched_moved_held_and_stopped(run: tuple[Served, Path]) -> None:
    """Every button is pressed, by mouse or keyboard; what is refused is counted; STOP works among hundreds."""
    served, folder = run
    about = next(served.frames())
    assert about["axes"][0]["moved"]
    served.until(lambda frame: frame["state"] == "running")
    wrong: list[str] = []
    with look.chromium() as browser:
        page, looking = browser.new_page(), browser.new_page()
        for one, token in ((page, CONTROL), (looking, READING)):
            one.set_default_timeout(look.PATIENCE)
            one.on("console", lambda message: wrong.append(message.text))
            one.on("request", lambda request: request.url.startswith(served.address) or wrong.append(request.url))
            one.goto(f"{served.address}#{token}")
            one.get_by_text("running").wait_for()
        assert looking.get_by_role("button", name="STOP").is_disabled()
        assert not looking.get_by_role("button", name="Go").count()
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
            for width in look.WIDTHS:
                page.set_viewport_size({"width": width, "height": 900})
                wrong += look.too_wide(page)
            wrong += look.inaccessible(page)
            assert {THEMES[scheme][role] for role in ("desired", "true")} <= look.marked(page)
        assert not wrong

        page.get_by_label("Set-point").fill("5")
        page.get_by_label("speed (µm/s)").fill("50")
        page.get_by_label("speed (µm/s)").press("Enter")
        there = served.until(lambda frame: abs((frame["axes"][0]["measured"] or [0.0])[-1] - 5.0) < 0.2)
        assert there["axes"][0]["target"] == 5.0
        assert len(there["axes"][0]["measured"]) <= frames.POINTS
        page.get_by_role("button", name="Hold learning").press("Space")
        assert served.until(lambda frame: frame["held"] and frame["axes"][0]["flags"] & 8)  # the controller has it
        page.get_by_role("button", name="Resume learning").click()
        served.until(lambda frame: not frame["held"])
        page.reload()  # as one that is opened later
        page.locator("body[data-frames]").wait_for()
        assert float(page.get_by_label("Set-point").input_value()) == pytest.approx(5.0, abs=0.01)
        page.get_by_label("Set-point").fill("6")
        page.get_by_role("button", name="Go").click()
        served.until(lambda frame: frame["axes"][0]["target"] == 6.0)

        refused_and_counted(served)
        page.get_by_text("1 too long").wait_for()
        crowd = [socket.create_connection(("127.0.0.1", served.port)) for _ in range(400)]
        for one in crowd[:100]:
            one.sendall(HANGING.format(served.port).encode())  # none of them reads
        for one in crowd[100:200]:
            one.sendall(b"POST /do HTTP/1.1\r\n")
        page.get_by_role("button", name="STOP").click()
        out, err = served.process.communicate(timeout=300)
        for one in crowd:
            one.close()
    result = json.loads(out)
    assert (result["cause"], result["reason"]) == ("stopped", "an operator asked for it"), err
    assert re.search(r"refused \d+ requests: 3 without a token that allows it, 1 from another page", err)
    recording = Recording.load(folder / "run.h5")
    assert np.abs(recording["measured"][-20:]).max() < 7.0


def refused_and_counted(served: Served) -> None:
    """Requests that change nothing; each is counted by its kind."""
    refused = [
        served.do(READING, do="stop"),
        served.do("wrong", do="stop"),
        served.do(origin="http://example.com", do="stop"),
        served.do(do="setpoint", axis=0, um=1e9),
        served.do(do="setpoint", axis=3, um=1.0),
        served.do(do="setpoint", axis=0, um=10**400),
        served.do(do="setpoint", axis=0, um=float("nan")),
        served.do(do="explode"),
        served.do(do="seek", s=1.0),  # this is no recording
        served.do(do="pace", factor=2.0),
        served.ask("POST", "/do", b"[" * 1000, Authorization=f"Bearer {CONTROL}")[0],
        served.ask("POST", "/stop", b"{}", Authorization=f"Bearer {CONTROL}")[0],
        served.ask("GET", "/stream")[0],
        served.ask("GET", "/", Host="example.com")[0],
        served.ask("GET", "/etc/passwd")[0],
    ]
    assert refused == [403, 403, 403, *[400] * 8, 404, 403, 421, 404]
    head = f"POST /do HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\nAuthorization: Bearer {CONTROL}\r\n"
    long = head.encode() + b"Content-Length: 10000000\r\n\r\n" + 20_000 * b"x"
    malformed = b"POST /do HTTP/1.1 and more\r\n\r\n", b"\x16\x03\x01\x02\r\n\r\n"
    for sent, status in ((long, b"413"), *((one, b"400") for one in malformed)):
        with socket.create_connection(("127.0.0.1", served.port)) as connection:
            connection.sendall(sent)
            assert connection.recv(100).startswith(b"HTTP/1.1 " + status)
    kinds = {"TOKEN": 3, "ORIGIN": 1, "HOST": 1, "PLACE": 2, "MALFORMED": 3, "VALUE": 7, "LONG": 1}
    expected = {access.WORDS[access.Refusal[kind]]: number for kind, number in kinds.items()}
    served.until(lambda frame: frame["refused"] == expected)
    answered, page, headers = served.ask("GET", "/")
    assert answered == 200
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert not re.search(rb"<script>|onclick|style=", page)


ONLY_LINUX = "send_fds recv_fds SCM_RIGHTS SOCK_SEQPACKET TCP_USER_TIMEOUT SO_BINDTODEVICE"
AS_ON_WINDOWS = f"""
import os, socket
for name in {ONLY_LINUX!r}.split():
    vars(socket).pop(name, None)
del os.nice
"""


def test_the_page_needs_no_more_of_sockets_than_each_system_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A page that nobody reads is given up; STOP works."""
    (tmp_path / "sitecustomize.py").write_text(AS_ON_WINDOWS)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "serve.toml").write_text(serving(60.0))
    served = Served(tmp_path, "serve", "--live", "--config", "serve.toml", "--json")
    served.until(lambda frame: frame["state"] == "running")
    assert served.ask("GET", "/live.js")[0] == 200
    assert served.ask("GET", "/stream")[0] == 403
    assert served.do(do="stop") == 200
    out, err = served.process.communicate(timeout=120)
    assert json.loads(out)["cause"] == "stopped", err
    assert "refused 1 requests: 1 without a token that allows it" in err


@contextlib.contextmanager
def relayed(asked: bytes) -> Iterator[tuple[relay.Relays, socket.socket, socket.socket, Callable[[], None]]]:
    """The relays with one visitor, who has asked; his end, that of the pages, and what passes on what is there."""
    with contextlib.ExitStack() as held:
        pages = held.enter_context(socket.create_server(("127.0.0.1", 0)))
        selector = held.enter_context(selectors.DefaultSelector())
        relays = relay.Relays(selector)
        reader, visitor = socket.socketpair()
        held.enter_context(reader)
        visitor.setblocking(False)
        relays.begin(visitor, asked, pages.getsockname()[1])
        there, _ = pages.accept()
        held.enter_context(there)

        def passes_on() -> None:
            for key, _ in selector.select(0.01):
                key.data(key.fileobj)
            relays.give_up()

        yield relays, reader, there, passes_on


def test_who_does_not_read_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bytes that nobody takes wait in the system's buffers; after ten seconds both ends are closed."""
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    with relayed(b"GET /stream") as (relays, reader, there, passes_on):
        passes_on()
        assert there.recv(100) == b"GET /stream"
        there.setblocking(False)
        sent = 0
        for _ in range(300):
            with contextlib.suppress(BlockingIOError):
                sent += there.send(bytes(100_000))
            passes_on()
        assert sent < 20_000_000  # the pages notice it
        clock[0] = 9.0
        for _ in range(20):  # it takes some
            reader.recv(65536)
            passes_on()
        clock[0] = 18.0
        for _ in range(5):
            passes_on()
        assert len(relays) == 1
        clock[0] = 40.0
        passes_on()
        assert len(relays) == 0


@pytest.mark.parametrize(
    ("asked", "later", "seconds", "kept"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", b"", 30.0, True),
        (b"GET / HTTP/1.1\r\n\r", b"\n", 30.0, True),
        (b"GET / HTTP/1.1\r\n\r\n", b"", 61.0, False),
        (b"GET / HT", b"TP", 6.0, False),
    ],
)
def test_pages_may_be_slow_and_a_visitor_may_not(
    asked: bytes, later: bytes, seconds: float, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where all processors are busy the pages, which give way, have answered after more than five seconds."""
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    with relayed(asked) as (relays, reader, there, passes_on):
        reader.sendall(later)

        def look() -> None:
            for _ in range(5):
                passes_on()

        look()
        clock[0] = seconds
        look()
        assert len(relays) == kept
        if kept:
            there.sendall(b"HTTP/1.1 200")
            look()
            assert reader.recv(100) == b"HTTP/1.1 200"
        for one in (reader, there):
            one.close()
        look()
        assert len(relays) == 0


def test_a_flood_of_orders_without_a_token_waits_and_stop_does_not() -> None:
    settings = LiveSettings(port=0, control=CONTROL, reading=READING)
    shared, bound = server.blank(1, 1000.0), settings.bound()
    try:
        shared.count[Slot.SERVER] = Helper.READY
        port = bound.getsockname()[1]
        orders = Orders(shared, [], 1000.0)
        taken = door.Door(access.Access(settings, port), orders, shared, bound, lambda: None)  # type: ignore[arg-type,return-value]

        def asked(token: str) -> socket.socket:
            made = socket.create_connection(("127.0.0.1", port))
            head = f"POST /do HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAuthorization: Bearer {token}\r\n"
            made.sendall(f'{head}Content-Length: 13\r\n\r\n{{"do":"stop"}}'.encode())
            return made

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(door, "PAUSE", 1e9)
            strangers = [asked("wrong") for _ in range(50)]
            strangers[0].shutdown(socket.SHUT_WR)
            while shared.count[Slot.REFUSED + access.Refusal.TOKEN] < 50:
                taken.look()
            operator = asked(CONTROL)
            while not shared.count[Slot.STOP]:
                taken.look()
        assert operator.recv(100).startswith(b"HTTP/1.1 200")
        for one in strangers:
            one.setblocking(False)
            with pytest.raises(BlockingIOError):
                one.recv(100)
        for later in (2e9, 3e9, 3e9):  # after the pause; all of them are closed then
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(time, "monotonic", lambda later=later: later)
                taken.look()
        for one in strangers:
            assert one.recv(100).startswith(b"HTTP/1.1 403")
            one.close()
        operator.close()
    finally:
        shared.close()
        bound.close()


def test_learning_is_watched_and_stopped(tmp_path: Path) -> None:
    """Within a pass that would last ten minutes."""
    text = config.example().partition("[realtime]")[0] + '[recording]\nfile = "run.h5"\n'
    (tmp_path / "stage.toml").write_text(text + TABLES)
    options = ["--frequency", "40", "--bandwidth", "400", "--averaged", "600", "--live"]
    served = Served(tmp_path, "learn", "raster", "--config", "stage.toml", *options)
    shown = served.until(lambda frame: frame["axes"][0]["rmse"] is None and frame["axes"][0]["measured"])["axes"][0]
    assert shown["target"] is None
    assert served.do(do="stop") == 200
    _, err = served.process.communicate(timeout=300)
    assert served.process.returncode == 15, err
    assert "an operator asked for the end on the live page" in err


def test_the_desired_motion_of_a_pass_is_shown_with_its_voltage() -> None:
    """It begins where the waveform does, behind ramp and rest; after STOP the output goes back to the safe voltage."""
    driver, rate = SimulatedDriver(), 2000.0
    wave = 1.0 + np.sin(2 * np.pi * np.arange(200) / 100)
    limits = {"voltage_limits": (-0.6, 3.6), "slew": 400.0, "safe_voltage": 0.0}
    shared = server.blank(1, rate)
    try:
        shared.count[Slot.STATE] = State.LIVE
        shown = Watched(driver, shared)
        before = lead(Limits(**limits), wave[0], rate, rest=0.05)
        shown.expect(10.0 * wave[:100], before.size)
        playback(shown, wave, rate, **limits, rest=0.05)
        desired, volts = (shared.ring[0, FIELDS.index(name)] for name in ("desired", "volts"))
        assert np.isnan(desired[: before.size]).all()
        during = slice(before.size, before.size + wave.size)
        np.testing.assert_allclose(desired[during], 10.0 * volts[during], rtol=0, atol=1e-9)
        shared.count[Slot.STOP] = 1
        with pytest.raises(StoppedError, match="an operator asked"):
            playback(shown, wave, rate, **limits)
        assert driver.output[0] == 0.0
        assert np.abs(np.diff(volts[np.isfinite(volts)])).max() <= 400.0 / rate + 1e-9
    finally:
        shared.close()


def test_a_recording_is_shown_again(tmp_path: Path) -> None:
    """Two axes from files: it pauses at its end, goes where the keyboard says, plays again and ends by button."""
    time = np.arange(1000) / 1000.0
    for name, low in (("x", 0.0), ("y", -1.0)):
        lines = {"desired": time, "measured": time + (time == 0.7), "volts": 0.1 * time, "lateness": 3.0 + 0 * time}
        channels = {"time": Channel(time, "s", "")} | {line: Channel(data, "um", "") for line, data in lines.items()}
        Recording(channels, {"axis": {"name": name, "voltage_limits": [low, 5.0]}}).save(tmp_path / f"run-{name}.h5")
    command = [COMMAND, "replay", "run-x.h5", "run-y.h5", "--speed", "100", "--port", "0"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    assert process.stderr
    with contextlib.ExitStack() as at_end, look.chromium() as browser:
        at_end.callback(process.kill)  # a test that fails must not leave it
        page = browser.new_page()
        page.set_default_timeout(look.PATIENCE)
        page.goto(process.stderr.readline().split()[-1])
        page.get_by_text("replay, paused").wait_for()
        page.get_by_text("1.0 s", exact=True).wait_for()
        page.get_by_text("99 % within 5 µs").wait_for()
        assert page.get_by_role("heading", name="Axis y").count() == 1
        winds_with_the_keyboard(page)
        page.set_viewport_size({"width": look.WIDTHS[0], "height": 900})
        assert look.too_wide(page) + look.inaccessible(page) == []
        assert not page.get_by_role("button", name="STOP").count()
        page.get_by_role("button", name="End").click()
        assert process.wait(300) == 0, process.stderr.read()
    process.stderr.close()


def winds_with_the_keyboard(page: Any) -> None:
    """Of a replay of 1 s that is at its end: to its beginning, to a place, to its end; again, a hundredth as fast."""
    slider, pace = page.get_by_role("slider", name="Time"), page.get_by_role("combobox", name="Speed")
    slider.press("Home")
    page.get_by_text("0.00 s of 1.00 s").wait_for()
    page.get_by_text("99 %").wait_for(state="detached")  # no block yet
    slider.fill("0.5")
    page.get_by_text("0.50 s of 1.00 s").wait_for()
    slider.press("End")
    page.locator("#time[aria-valuetext^='1.00 s']").wait_for()
    assert pace.input_value() == "100"
    with page.expect_response("**/do"):
        pace.select_option("0.01")
    page.get_by_role("button", name="Play").press("Enter")
    page.get_by_text(re.compile(r"0\.0[1-9] s of")).wait_for()
    assert page.get_by_role("button", name="Pause").count() == 1  # it would have ended long ago


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run.h5"], "must be at least 2 ticks, which can be shown"),
        (["run.h5", "--speed", "0"], "speed = 0"),
        (["run.h5", "--port", "80"], "--port = 80: must be a whole number from 1024 to 65535"),
    ],
)
def test_what_cannot_be_shown_again_is_one_line(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Recording({"time": Channel(np.zeros(1), "s", "")}).save("run.h5")
    done = CliRunner().invoke(main, ["replay", *arguments])
    assert done.exit_code == 2
    assert words in done.output


def test_a_port_that_is_taken_is_said_before_anything_moves() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(RealtimeError, match=rf"port {port} .*choose another `port` in the table \[live\]"):
            LiveSettings(port=port).check([])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"port": 80}, "port = 80: must be a whole number from 1024 to 65535"),
        ({"window": 60.0}, "window = 60"),
        ({"control": "short"}, "control = a token: must be of at least 16 characters"),
        ({"control": "x" * 20, "reading": "x" * 20}, "another one than that of control"),
    ],
)
def test_what_is_wrong_in_the_settings_is_named(given: dict[str, Any], words: str) -> None:
    with pytest.raises(SettingError, match=re.escape(words)):
        LiveSettings(**given)


def test_tokens_are_others_in_each_run_and_not_shown() -> None:
    one, other = LiveSettings(), LiveSettings()
    assert len({one.control, one.reading, other.control, other.reading}) == 4
    assert one.control not in repr(one)


def test_a_frame_keeps_a_spike_and_says_what_is_lost() -> None:
    shared = Shared(Layout(channels=1, size=20_000, slow_size=4, slow_width=1))
    try:
        shared.count[Slot.STATE], shared.count[Slot.TICKS] = State.LIVE, 40_000
        ring = shared.ring[0]
        ring[:] = 0.0
        ring[FIELDS.index("measured"), 15_003] = 9.0
        ring[FIELDS.index("measured"), 16_000:16_100] = np.nan
        ring[FIELDS.index("flags"), 17_900] = 32
        axis = Panel(name="x", voltage_limits=(0.0, 1.0), reach=(0.0, 1.0), moved=False, weights=0)
        made = frames.frame(shared, [axis], 10_000.0, 1.8, 18_000)
        shown = json.loads(frames.encoded(made))["axes"][0]
    finally:
        shared.close()
    assert max(value for value in shown["measured"] if value is not None) == 9.0
    assert None in shown["measured"]
    assert shown["flags"] == 32
    at = shown["start"] + shown["step"] * shown["measured"].index(9.0)
    assert at == pytest.approx(1.5003, abs=0.01)
