"""From STOP on the live page until the output is safe, whatever its readers do: python benchmarks/live_stop.py.

Each line is of several runs, which take turns. The voltage is read where the simulated converter shows it to other
processes. `ramp` is the part of the time that the slew limit takes. A laptop that is closed needs root: a network of
its own, whose cable is cut.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import json
import os
import random
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from truestroke.base import system
from truestroke.runtime.realtime import config

PROGRAM = str(Path(sys.executable).with_name("truestroke"))
CONTROL, READING = "control-" * 3, "reading-" * 3
HERE, THERE = "10.231.7.1", "10.231.7.2"
SLEW = float(re.search(r"(?m)^slew = ([\d.]+)", config.example())[1])  # type: ignore[index] # V/s
SAFE = 0.0  # V
LONGEST = 20.0  # s that a STOP may take before it counts as lost


# ---- Those who look on ----------------------------------------------------------------------------------------------


def _opened(host: str, port: int) -> socket.socket:
    made = socket.socket()
    made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    made.connect((host, port))
    return made


def _asking(host: str, port: int, token: str = READING) -> socket.socket:
    made = _opened(host, port)
    made.sendall(f"GET /stream HTTP/1.1\r\nHost: {host}:{port}\r\nAuthorization: Bearer {token}\r\n\r\n".encode())
    return made


def _drained(made: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while made.recv(65536):
            pass


def reading(host: str, port: int) -> list[socket.socket]:
    """Ten pages that are looked at."""
    made = [_asking(host, port) for _ in range(10)]
    for one in made:
        threading.Thread(target=_drained, args=(one,), daemon=True).start()
    return made


def hanging(host: str, port: int) -> list[socket.socket]:
    """As many pages as there may be, none of which reads."""
    return [_asking(host, port) for _ in range(32)]


def thousand(host: str, port: int) -> list[socket.socket]:
    """A thousand connections: that say nothing, that stop within a request, that ask for the stream."""
    made = [_opened(host, port) for _ in range(400)]
    for one in made[:200]:
        one.sendall(b"POST /do HTTP/1.1\r\nHost: ")
    return made + [_asking(host, port) for _ in range(600)]


def hammering(host: str, port: int, method: str = "GET", path: str = "/stream") -> list[socket.socket]:
    """Twenty connections that ask without a token, again as soon as they are answered, on one processor."""

    def ask() -> None:
        connection = http.client.HTTPConnection(host, port, timeout=60)
        with contextlib.suppress(OSError, http.client.HTTPException):
            while True:
                connection.request(method, path)
                connection.getresponse().read()

    for _ in range(20):
        threading.Thread(target=ask, daemon=True).start()
    return []


def ordering(host: str, port: int) -> list[socket.socket]:
    """The same, with orders."""
    return hammering(host, port, "POST", "/do")


CROWDS: dict[str, Callable[[str, int], list[socket.socket]]] = {
    "ten readers": reading,
    "32 hung readers": hanging,
    "a thousand connections": thousand,
    "20 that hammer": hammering,
    "20 that order": ordering,
    "a closed laptop": hanging,
}


def crowd(name: str, host: str, port: int) -> None:
    """Be one of these, until stdin is closed."""
    system.allow_many_files()
    made = CROWDS[name](host, port)
    print(len(made), flush=True)
    sys.stdin.read()


@contextlib.contextmanager
def among(name: str | None, host: str, port: int) -> Iterator[None]:
    """With such a crowd, in a process of its own; of a closed laptop the cable is cut when it is there."""
    if name is None:
        yield
        return
    away = ["ip", "netns", "exec", "truestroke"] if name == "a closed laptop" else []
    command = [*away, sys.executable, __file__, "--crowd", name, host, str(port)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout
    process.stdout.readline()
    time.sleep(0.5)
    if away:
        subprocess.run(["ip", "link", "set", "truestroke0", "down"], check=True)
    try:
        yield
    finally:
        process.kill()
        process.communicate()


@contextlib.contextmanager
def network() -> Iterator[bool]:
    """Another computer, for the laptop: whether there is one."""
    down = "ip link del truestroke0; ip netns del truestroke"
    subprocess.run(down, shell=True, capture_output=True, check=False)  # of one that was killed
    up = f"""ip netns add truestroke && ip link add truestroke0 type veth peer name truestroke1 netns truestroke &&
    ip addr add {HERE}/24 dev truestroke0 && ip -n truestroke addr add {THERE}/24 dev truestroke1 &&
    ip -n truestroke link set truestroke1 up"""
    made = subprocess.run(up, shell=True, capture_output=True, check=False).returncode == 0
    try:
        yield made
    finally:
        if made:
            subprocess.run(down, shell=True, check=False)


# ---- One STOP -------------------------------------------------------------------------------------------------------


def press(host: str, port: int) -> None:
    """STOP, as the button of a page does it."""
    connection = http.client.HTTPConnection(host, port, timeout=LONGEST)
    connection.request("POST", "/do", json.dumps({"do": "stop"}), {"Authorization": f"Bearer {CONTROL}"})
    connection.getresponse().read()
    connection.close()


def stopped(folder: Path, name: str | None) -> tuple[float, float]:
    """ms until the output was safe, and what of it the slew limit took."""
    host = HERE if name == "a closed laptop" else "127.0.0.1"
    if host == HERE:
        subprocess.run(["ip", "link", "set", "truestroke0", "up"], check=True)
        time.sleep(0.2)
    register = folder / "output"
    text = re.sub(r"(?m)^\[driver\]", f'[driver]\nregister = "{register}"', config.example())
    text = re.sub(r"(?m)^overrun_streak = .*", "overrun_streak = 0", text)
    text = re.sub(r"(?m)^watchdog_timeout = .*", "watchdog_timeout = 20.0", text)  # the load may stop it for longer
    tokens = f'\n[live]\nport = 0\ninterface = "{host}"\ncontrol = "{CONTROL}"\nreading = "{READING}"\n'
    (folder / "stage.toml").write_text(text + tokens)
    command = [PROGRAM, "run", "--live", "--config", "stage.toml", "--overwrite", "--json"]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert process.stderr
    said = ""
    while not (found := re.search(r":(\d+)/#", said)):
        line = process.stderr.readline()
        assert line, said
        said += line
    port = int(found[1])
    output = np.memmap(register, np.float64, "r", shape=(1,))
    while abs(output[0]) < 0.5:  # the soft start is over, and the wave is somewhere
        time.sleep(0.01)
    with among(name, host, port):
        time.sleep(random.uniform(0.5, 1.0))
        threading.Thread(target=press, args=(host, port), daemon=True).start()
        at, began = float(output[0]), time.monotonic()
        while output[0] != SAFE and time.monotonic() - began < LONGEST:
            time.sleep(0.0005)
        took = time.monotonic() - began
    process.communicate()
    return 1e3 * took, 1e3 * abs(at - SAFE) / SLEW


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--turns", type=int, default=8)
    parser.add_argument("--crowd", nargs=3, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.crowd:
        crowd(asked.crowd[0], asked.crowd[1], int(asked.crowd[2]))
        return
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors; slew limit {SLEW:g} V/s")
    with tempfile.TemporaryDirectory() as scratch, network() as cable:
        names: list[str | None] = [None, *(name for name in CROWDS if cable or name != "a closed laptop")]
        if not cable:
            print("a closed laptop: not tried, it needs root and `ip netns`")
        found: dict[str | None, list[tuple[float, float]]] = {name: [] for name in names}
        for _ in range(asked.turns):
            for name in names:
                found[name].append(stopped(Path(scratch), name))
    print(f"{'until the output is safe, ms':30}{'median':>10}{'largest':>10}{'of it ramp':>14}")
    for name, times in found.items():
        took, ramps = np.array(times).T
        row = f"{np.median(took):10.1f}{took.max():10.1f}{ramps[took.argmax()]:14.1f}"
        print(f"{name or 'nobody else':30}{row}")


if __name__ == "__main__":
    main()
