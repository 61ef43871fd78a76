"""A fake controller of Physik Instrumente: speaks GCS 2.0 over TCP, drives a simulated stack on each of two axes.

`python gcs.py FILE` prints its port. FILE is what a voltmeter at the piezo outputs sees (tests/controller.py reads it).
A servo cycle takes 100 us: the sensor is read, the recorder takes its sample, the wave generator puts its next point
out. Cycles pass with the computer's clock ("realtime"), or when they are needed: five before each POS?, a wave at once.

A line "FAKE {...}" makes a new controller of it; members: fault "COMMAND:n:what", and attributes of Controller. n: the
n-th such command from 0, ">n": those behind it, "*": all. what: an error code, or drop (the connection), late, silent,
garbage; and of the recorder (commands ROWS, NAN, VOLTS) short, nan, clip.
"""

from __future__ import annotations

import contextlib
import json
import selectors
import socket
import sys
import time

import numpy as np

from truestroke.plant import PlantSettings, RealisticPlant

CYCLE = 100e-6  # s
PLANT = PlantSettings(sample_rate=1 / CYCLE, samples_per_tick=1, steps_per_tick=2)
GAIN = PLANT.amplifier_gain  # the plant's D/A volts to piezo volts
UNKNOWN, SYNTAX, SERVO_OFF, LIMITS, STOPPED, AXIS, RANGE, PARAMETER, TOO_LARGE, ACTIVE, NO_WAVE = (
    2, 1, 5, 7, 10, 15, 17, 54, 67, 73, 75
)  # fmt: skip
OPTIONS = {
    1: "Target Position of axis", 2: "Current Position of axis", 7: "Control Voltage of output chan",
    16: "Voltage of output chan",
}  # fmt: skip
TABLES = 8


class RefusedError(Exception):
    """An error code for ERR?."""


class Controller:
    def __init__(self, file: np.ndarray, **settings: object) -> None:
        self.fault, self.realtime, self.connections, self.axes = "", False, 8, ["1", "2"]
        self.limits, self.factor, self.points, self.wave_points, self.seed = [-20.0, 120.0], 1.0, 262144, 262144, 0
        self.volts, self.servo = [0.0, 0.0], [False, False]
        self.delay, self.syntax = 0.0, 2.0  # s, before each answer; of GCS
        self.__dict__.update(settings)
        self.file = file
        self.error, self.counts = 0, {}
        self.stacks = [RealisticPlant(PLANT, seed=self.seed + i) for i in range(2)]
        for stack in self.stacks:
            stack.open()
        self.position = [0.0, 0.0]
        self.tables = {i: np.empty(0) for i in range(1, 5)}
        self.selected, self.cycles_of, self.rates = [0, 0], [1, 1], [1, 1]
        self.recorded = {i: (i, 2) if i < 3 else (0, 0) for i in range(1, TABLES + 1)}
        self.record_rate, self.record = 1, np.zeros((0, 4))  # um and V of both
        self.running: list[int] = []
        self.clock, self.passed = time.monotonic(), 0.0
        self.show()

    # ---- Time ------------------------------------------------------------------------------------------------------

    def show(self) -> None:
        self.file[:2] = self.volts

    def hold(self, cycles: int) -> None:
        """Cycles under the voltages that are there."""
        for i, stack in enumerate(self.stacks):
            if cycles > 0:
                self.position[i] = stack.exchange(np.full(cycles, self.volts[i] / GAIN))[-1]

    def put(self, index: int, volts: float) -> None:
        self.file[2] = max(self.file[2], abs(volts - self.volts[index]))
        self.volts[index] = volts
        self.show()

    def begin(self) -> None:
        """The whole wave, computed at once; shown as it goes."""
        self.waves = {i: np.repeat(self.tables[self.selected[i]], self.rates[i]) * self.factor for i in self.running}
        self.length = max(w.size for w in self.waves.values())
        room = min(self.points // TABLES * self.record_rate, self.length + 500)  # it records on, up to its memory
        took = np.zeros((4, room))
        for i, wave in self.waves.items():
            stack, wave = self.stacks[i], wave[:room]
            volts = np.concatenate([wave, np.full(room - wave.size, wave[-1])])
            z = stack.exchange(volts / GAIN)
            took[i] = np.append(self.position[i], z[:-1])  # the sensor comes before the output in a cycle
            took[2 + i] = np.append(self.volts[i], volts[:-1])
            self.position[i] = z[-1]
        self.record = took[:, :: self.record_rate].T
        self.clock, self.passed = time.monotonic(), 0.0
        if not self.realtime:
            self.advance(finish=True)

    def advance(self, finish: bool = False) -> None:
        if not self.running:
            if self.realtime:
                now = time.monotonic()
                self.hold(min(int((now - self.clock) / CYCLE), 500))
                self.clock = now
            return
        at = self.length if finish else min(int((time.monotonic() - self.clock) / CYCLE), self.length)
        self.passed = at
        for i, wave in self.waves.items():
            if at:
                self.file[2] = max(self.file[2], np.abs(np.diff(wave[:at], prepend=self.volts[i])).max(initial=0.0))
                self.volts[i] = wave[min(at, wave.size) - 1]
        self.show()
        if at >= self.length:
            self.running = []

    def taken(self) -> int:
        """Points that the recorder has by now."""
        if self.realtime and self.running:
            return min(int(self.passed) // self.record_rate, len(self.record))
        return len(self.record)

    # ---- Commands --------------------------------------------------------------------------------------------------

    def answer(self, line: str) -> tuple[str | None, str]:
        """Answer and fault of a line or a single character."""
        names = {"\x05": "#5", "\x07": "#7", "\x09": "#9", "\x18": "#24"}
        word, *arguments = [names[line]] if line in names else line.split()
        word = word.upper()
        self.file[3] += 1
        self.advance()
        fault = self.due(word)
        if fault.lstrip("-").isdigit():
            self.error = int(fault)
            return None, ""
        method = getattr(self, "do_" + word.replace("?", "_").replace("*", "").replace("#", "n"), None)
        try:
            if method is None:
                raise RefusedError(UNKNOWN)
            return method(*arguments), fault
        except RefusedError as error:
            self.error = error.args[0]
        except (ValueError, TypeError, KeyError, IndexError):
            self.error = SYNTAX
        return None, fault

    def due(self, word: str) -> str:
        if not self.fault:
            return ""
        command, n, what = self.fault.split(":")
        if word != command:
            return ""
        count = self.counts[word] = self.counts.get(word, -1) + 1
        return what if n == "*" or (count > int(n[1:]) if n[0] == ">" else count == int(n)) else ""

    def index(self, name: str) -> int:
        if name not in self.axes:
            raise RefusedError(AXIS)
        return self.axes.index(name)

    def each(self, names: tuple[str, ...], value) -> str:
        names = names or tuple(self.axes)
        return " \n".join(f"{name}={value(self.index(name))}" for name in names) + "\n"

    def do_IDN_(self) -> str:
        return "(c)2015 Physik Instrumente (PI) GmbH & Co. KG, E-727.3CD (fake), 0111176619, 13.21.00.09\n"

    def do_CSV_(self) -> str:
        return f"{self.syntax}\n"

    def do_ERR_(self) -> str:
        error, self.error = self.error, 0
        return f"{error}\n"

    def do_SAI_(self, *_: str) -> str:
        return " \n".join(self.axes) + "\n"

    def do_HPA_(self) -> str:
        return (
            "The following parameters are valid: \n"
            "0xe000200=\t0\t1\tFLOAT\tsystem\tServo Update Time \n"
            "0x16000200=\t0\t1\tINT\tsystem\tData Recorder Max Points \n"
            "0xc000000=\t0\t1\tFLOAT\tchannel\tlow \n0xc000001=\t0\t1\tFLOAT\tchannel\thigh \nend of help\n"
        )

    def do_HDR_(self) -> str:
        return "#RecordOptions \n" + "".join(f"{k}={v} \n" for k, v in OPTIONS.items()) + "end of help\n"

    def do_SPA_(self, item: str, parameter: str) -> str:
        low, high = self.limits
        known = {0x0E000200: CYCLE, 0x16000200: self.points, 0x0C000000: low, 0x0C000001: high}
        if int(parameter, 0) not in known:
            raise RefusedError(PARAMETER)
        return f"{item} {parameter}={known[int(parameter, 0)]}\n"

    def do_TNR_(self) -> str:
        return f"{TABLES}\n"

    def do_VMI_(self, channel: str) -> str:
        return f"{channel}={self.limits[0]}\n"

    def do_VMA_(self, channel: str) -> str:
        return f"{channel}={self.limits[1]}\n"

    def do_VOL_(self, channel: str) -> str:
        return f"{channel}={self.volts[int(channel) - 1]}\n"

    def do_SVO_(self, *axes: str) -> str:
        return self.each(axes, lambda i: int(self.servo[i]))

    def do_SVO(self, *pairs: str) -> None:
        for name, value in zip(pairs[::2], pairs[1::2], strict=True):
            self.servo[self.index(name)] = value == "1"

    def do_SVA_(self, *axes: str) -> str:
        return self.each(axes, lambda i: f"{self.volts[i] / self.factor:.6f}")

    def do_SVA(self, *pairs: str) -> None:
        for name, value in zip(pairs[::2], pairs[1::2], strict=True):
            i, volts = self.index(name), float(value) * self.factor
            if self.running:
                raise RefusedError(ACTIVE)
            if self.servo[i]:
                raise RefusedError(SERVO_OFF)
            if not self.limits[0] - 1e-9 <= volts <= self.limits[1] + 1e-9:
                raise RefusedError(LIMITS)
            self.put(i, volts)

    def do_POS_(self, *axes: str) -> str:
        if not self.realtime and not self.running:
            self.hold(5)
        return self.each(axes, lambda i: f"{self.position[i]:.6f}")

    def do_WCL(self, *tables: str) -> None:
        for table in tables:
            self.tables[int(table)] = np.empty(0)

    def do_WAV(self, table: str, append: str, kind: str, first: str, count: str, *values: str) -> None:
        new = np.array(values, float)
        if kind != "PNT" or len(new) != int(count) or len(new) > 72:
            raise RefusedError(SYNTAX)
        old = self.tables[int(table)] if append == "&" else np.empty(0)
        if not np.all((self.limits[0] <= new * self.factor) & (new * self.factor <= self.limits[1])):
            raise RefusedError(RANGE)
        if old.size + new.size > self.wave_points:
            raise RefusedError(TOO_LARGE)
        self.tables[int(table)] = np.append(old, new)

    def do_WAV_(self, table: str, parameter: str) -> str:
        return f"{table} {parameter}={self.tables[int(table)].size}\n"

    def do_WSL(self, *pairs: str) -> None:
        for generator, table in zip(pairs[::2], pairs[1::2], strict=True):
            self.selected[int(generator) - 1] = int(table)

    def do_WGC(self, *pairs: str) -> None:
        for generator, cycles in zip(pairs[::2], pairs[1::2], strict=True):
            self.cycles_of[int(generator) - 1] = int(cycles)

    def do_WOS(self, *pairs: str) -> None:
        pass

    def do_WTR(self, *triples: str) -> None:
        for generator, rate in zip(triples[::3], triples[1::3], strict=True):
            self.rates[int(generator) - 1] = int(rate)

    def do_WGO(self, *pairs: str) -> None:
        running = [int(g) - 1 for g, mode in zip(pairs[::2], pairs[1::2], strict=True) if mode != "0"]
        if not running:
            self.running = []
            return
        for i in running:
            if self.selected[i] == 0 or self.tables[self.selected[i]].size == 0:
                raise RefusedError(NO_WAVE)
        self.running = running
        self.begin()

    def do_WGO_(self, *generators: str) -> str:
        return " \n".join(f"{g}={int(int(g) - 1 in self.running)}" for g in generators or ("1", "2")) + "\n"

    def do_n9(self) -> str:
        return f"0x{sum(1 << i for i in self.running):x}\n"

    def do_n5(self) -> str:
        return "0x0\n"

    def do_n7(self) -> str:
        return "\xb1\n"

    def do_n24(self) -> None:
        self.running, self.error = [], STOPPED

    def do_STP(self, *_: str) -> None:
        self.do_n24()

    def do_HLT(self, *_: str) -> None:
        self.do_n24()

    def do_RTR(self, rate: str) -> None:
        self.record_rate = int(rate)

    def do_RTR_(self) -> str:
        return f"{self.record_rate}\n"

    def do_DRC(self, *triples: str) -> None:
        for table, source, option in zip(triples[::3], triples[1::3], triples[2::3], strict=True):
            if int(option) not in OPTIONS:
                raise RefusedError(RANGE)
            channel = self.index(source) + 1 if int(option) < 3 else int(source)
            self.recorded[int(table)] = channel, int(option)

    def do_DRT(self, table: str, source: str, value: str) -> None:
        pass

    def do_DRL_(self, *tables: str) -> str:
        return " \n".join(f"{table}={self.taken()}" for table in tables) + "\n"

    def do_DRR_(self, offset: str, count: str, *tables: str) -> str:
        at, n = int(offset) - 1, int(count)
        columns = []
        for table in tables:
            source, option = self.recorded[int(table)]
            columns.append(self.record[at : at + n, source - 1 + (0 if option < 3 else 2)])
        rows = np.stack(columns, axis=1)
        if self.due("NAN") == "nan":
            rows[400:410, 0] = np.nan
        if self.due("ROWS") == "short":
            rows = rows[: n // 2]
        if self.due("VOLTS") == "clip":
            rows[:, 1::2] = np.minimum(rows[:, 1::2], 20.0)
        names = "".join(
            f"# NAME{i} = {OPTIONS[self.recorded[int(t)][1]]}{self.recorded[int(t)][0]} \n"
            for i, t in enumerate(tables)
        )
        head = (
            f"# REM E-727.3CD (fake) \n# \n# VERSION = 1 \n# TYPE = 1 \n# SEPARATOR = 32 \n# DIM = {len(tables)} \n"
            f"# SAMPLE_TIME = {self.record_rate * CYCLE:.6f} \n# NDATA = {n} \n# \n{names}# \n# END_HEADER \n"
        )
        line = " ".join(["%.6f"] * len(tables))
        return head + " \n".join([line] * len(rows)) % tuple(rows.ravel().tolist()) + "\n"


# ---- Sockets -------------------------------------------------------------------------------------------------------


def lines(buffer: bytes) -> tuple[list[str], bytes]:
    """Whole lines and single characters of what has come in, and the rest."""
    found: list[str] = []
    while buffer:
        if buffer[:1] in b"\x05\x07\x09\x18":
            found.append(buffer[:1].decode())
            buffer = buffer[1:]
            continue
        line, end, rest = buffer.partition(b"\n")
        if not end:
            break
        found.append(line.decode("cp1252").strip())
        buffer = rest
    return [line for line in found if line], buffer


def serve(path: str) -> None:
    file = np.memmap(path, np.float64, "w+", shape=(8,))
    server = socket.create_server(("127.0.0.1", 0))
    selector = selectors.DefaultSelector()
    selector.register(server, selectors.EVENT_READ)
    controller, clients = Controller(file), {}
    print(server.getsockname()[1], flush=True)  # noqa: T201

    def drop(client: socket.socket) -> None:
        selector.unregister(client)
        clients.pop(client)
        client.close()
        file[4] = len(clients)

    while True:
        for key, _ in selector.select(0.005 if controller.realtime else None):
            if key.fileobj is server:
                client, _ = server.accept()
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                selector.register(client, selectors.EVENT_READ)
                clients[client] = b""
                file[4] = len(clients)
                continue
            client = key.fileobj
            try:
                came = client.recv(65536)
            except OSError:
                came = b""
            if not came:
                drop(client)
                continue
            found, clients[client] = lines(clients[client] + came)
            for line in found:
                if line.startswith("FAKE "):
                    for other in [c for c in clients if c is not client]:
                        drop(other)
                    file[:4] = 0.0
                    controller = Controller(file, **json.loads(line[5:]))
                    client.sendall(b"ok\n")
                    continue
                if list(clients).index(client) >= controller.connections:
                    drop(client)
                    break
                answer, fault = controller.answer(line)
                if fault == "drop":
                    drop(client)
                    break
                if fault == "silent":
                    break
                if late := 1.0 if fault == "late" else controller.delay:
                    time.sleep(late)
                answer = "?!\n" if fault == "garbage" else answer
                if answer is not None:
                    with contextlib.suppress(OSError):  # the other end is gone
                        client.sendall(answer.encode("cp1252"))
        if controller.realtime:
            controller.advance()


if __name__ == "__main__":
    serve(sys.argv[1])
