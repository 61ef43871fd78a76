"""Fake instruments that are spoken to in lines of text, over TCP or a pseudo terminal: each drives a simulated stack.

What a voltmeter at the output reads is `volts`. A position takes one tick of the stack, so nothing depends on a clock.
`fault` is "WORD:n:what": what happens at the n-th line, from 0, that begins with WORD; what is silent, garbage, drop
(the connection), or the line that is answered.
"""

from __future__ import annotations

import os
import socket
import threading
from contextlib import suppress

from truestroke.plant import PlantSettings, RealisticPlant

PLANT = PlantSettings(sample_rate=100.0)
GAIN = PLANT.amplifier_gain  # the plant's D/A volts to piezo volts


class Instrument:
    """A generic one: VOLT1 12.5, VOLT1?, POS1?, *IDN?, STOP; `reply` is what it answers to a voltage."""

    end, reply, name = "\n", "", "ACME,Amp 1,42,1.0"

    def __init__(self) -> None:
        self.volts, self.heard, self.fault, self.counts = 0.0, [], "", {}
        self.stack = RealisticPlant(PLANT, seed=3)
        self.stack.open()
        self._server = socket.create_server(("127.0.0.1", 0))
        self._connections: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def resource(self) -> str:
        return f"TCPIP::127.0.0.1::{self._server.getsockname()[1]}::SOCKET"

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._server.accept()
                self._connections.append(connection)
                threading.Thread(target=self.serve, args=(connection.fileno(),), daemon=True).start()

    def close(self) -> None:
        for one in (self._server, *self._connections):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def serve(self, descriptor: int) -> None:
        """Answer the lines that come on this descriptor, until its end."""
        waiting = b""
        with suppress(OSError):
            while data := os.read(descriptor, 4096):
                waiting += data
                while b"\n" in waiting:
                    line, waiting = waiting.split(b"\n", 1)
                    if not self.handle(descriptor, line.decode().strip()):
                        return

    def handle(self, descriptor: int, line: str) -> bool:
        """Answer a line; False where the connection is dropped."""
        self.heard.append(line)
        what = self.due(line)
        if what == "drop":
            for connection in self._connections:
                with suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)
            return False
        said = "" if what == "silent" else "\xff@7" if what == "garbage" else what or self.answer(line)
        if said:
            os.write(descriptor, (said + self.end).encode("latin-1"))
        return True

    def due(self, line: str) -> str:
        if not self.fault:
            return ""
        word, n, what = self.fault.split(":", 2)
        if not line.startswith(word):
            return ""
        self.counts[word] = self.counts.get(word, -1) + 1
        return what if self.counts[word] == int(n) else ""

    def position(self) -> float:
        return float(self.stack.exchange([self.volts / GAIN])[0])

    def answer(self, line: str) -> str:
        word, _, number = line.partition(" ")
        if word == "VOLT1":
            self.volts = float(number)
            return self.reply
        return {"VOLT1?": f"{self.volts:.6f}", "POS1?": f"POS {self.position():.6f} um", "*IDN?": self.name}.get(
            word, ""
        )


class Nv200(Instrument):
    """The commands of an nv200 that the driver uses, with the flow control that the network interface passes on."""

    end = "\r\n\x11"

    def __init__(self) -> None:
        self.values = {"modsrc": 0.0, "cl": 0.0, "acmeasure": 1.0, "avmin": -20.0, "avmax": 130.0, "grun": 1.0}
        super().__init__()

    def answer(self, line: str) -> str:
        word, _, number = line.partition(",")
        if word == "meas":
            return f"\x13meas,{self.position():.3f}"
        if word == "set" and number:
            if self.values["cl"] or not self.values["avmin"] <= float(number) <= self.values["avmax"]:
                return "\x13error,5"  # a voltage is no position
            self.volts = float(number)
            return ""
        if number:
            self.values[word] = float(number)
            return ""
        return f"\x13set,{self.volts:.3f}" if word == "set" else f"\x13{word},{self.values[word]:g}"
