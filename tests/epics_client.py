"""A client of Channel Access for test_epics.py: does what it is told, prints what it saw as JSON."""

from __future__ import annotations

import asyncio
import json
import math
import os
import signal
import sys
from typing import Any

import numpy as np
from aioca import FORMAT_CTRL, FORMAT_TIME, caget, camonitor, caput

PATIENCE = 20.0  # s of a busy machine
STAGE = "TEST:STAGE:"


async def get(name: str, **options: Any) -> Any:
    return await caget(STAGE + name, timeout=PATIENCE, **options)


async def put(name: str, value: float) -> None:
    await caput(STAGE + name, value, wait=True, timeout=PATIENCE)


async def until(name: str, value: float, tolerance: float = 0.0) -> float:
    """What it shows once it is there."""
    for _ in range(round(PATIENCE / 0.05)):
        shown = float(await get(name))
        if abs(shown - value) <= tolerance:
            return shown
        await asyncio.sleep(0.05)
    raise TimeoutError(f"{name} is {shown}, not {value}")


async def whole(name: str, length: int) -> None:
    """Wait until a wave has as many ticks as it ever shows."""
    for _ in range(round(PATIENCE / 0.05)):
        if len(await get(name)) == length:
            return
        await asyncio.sleep(0.05)
    raise TimeoutError(f"{name} does not show {length} ticks")


def about(value: Any) -> dict[str, Any]:
    names = ("units", "severity", "lower_disp_limit", "upper_disp_limit", "lower_ctrl_limit", "upper_ctrl_limit")
    return {"value": np.asarray(value).tolist(), **{name: getattr(value, name, None) for name in names}}


async def move() -> dict[str, Any]:
    """Two targets, what must be refused, all that there is to read, STOP."""
    await until("STATE", 2)
    seen: dict[str, Any] = {"first": about(await get("X:SETPOINT", format=FORMAT_CTRL))}
    await put("X:SETPOINT", 12.0)
    await until("X:READBACK", 12.0, 0.3)
    await until("X:MOVING", 0)
    seen["there"] = await until("X:DESIRED", 12.0, 1e-9)
    await put("X:SETPOINT", 99.0)
    await until("X:READBACK", 28.0, 0.3)
    await put("X:SETPOINT", math.nan)
    seen["beyond"] = float(await get("X:SETPOINT"))
    for name in ("X:VOLTS", "X:READBACK", "X:RMSE", "OVERRUNS", "SAMPLE_RATE", "TIME_LEFT", "Y:READBACK", "X:WEIGHTS"):
        seen[name] = about(await get(name, format=FORMAT_CTRL))
    await whole("Y:DESIRED:WAVE", 1000)
    for name in ("DESIRED", "MEASURED", "ERROR"):
        seen[name] = about(await get(f"Y:{name}:WAVE", format=FORMAT_CTRL))
    seen["y is moved"] = (await caget(STAGE + "Y:SETPOINT", timeout=0.5, throw=False)).ok
    seen["written"] = await forbidden()
    seen["written by PV Access"] = by_pv_access()
    await put("STOP", 1)
    return seen


FORBIDDEN = (
    *(f"{name}.{field}" for name in ("STOP", "X:SETPOINT", "X:READBACK") for field in ("DISP", "SCAN", "ASG", "PROC")),
    *(f"X:SETPOINT.{field}" for field in ("DRVH", "DRVL", "OUT", "OMSL", "SDIS", "SIMM", "EGU")),
    *("STOP.OUT", "STOP.SDIS", "STOP.OMSL", "X:READBACK", "X:VOLTS", "STATE", "X:WEIGHTS", "X:READBACK.INP"),
)


async def forbidden() -> list[str]:
    """What a client may not write, but could, by Channel Access."""
    done = await caput([STAGE + name for name in FORBIDDEN], 1, repeat_value=True, timeout=PATIENCE, throw=False)
    return [str(one.name) for one in done if one.ok]


def by_pv_access() -> list[str]:
    """The same by PV Access, where a place shows that it answers at all."""
    from p4p.client.thread import Context, RemoteError

    written = []
    with Context("pva") as context:
        context.get(STAGE + "X:READBACK", timeout=PATIENCE)
        for name in ("STOP.DISP", "X:SETPOINT.DRVH", "X:READBACK", "STATE", "X:SETPOINT"):
            try:
                context.put(STAGE + name, 1, timeout=PATIENCE)
                written.append(name)
            except RemoteError as error:
                if "permitted" not in str(error) and "putDisabled" not in str(error):
                    written.append(f"{name}: {error}")
    return written


async def lose(pid: int) -> dict[str, Any]:
    """Kill the loop, and listen."""
    await until("STATE", 2)
    await until("X:READBACK", 0.0, 0.3)
    states: list[tuple[int, int]] = []
    places: list[int] = []
    camonitor(STAGE + "STATE", lambda v: states.append((int(v), v.severity)), format=FORMAT_TIME)
    camonitor(STAGE + "X:READBACK", lambda v: places.append(v.severity), format=FORMAT_TIME)
    while not (states and places):
        await asyncio.sleep(0.02)
    os.kill(pid, signal.SIGKILL)
    for _ in range(round(PATIENCE / 0.05)):
        if states[-1][0] == 5 and places[-1]:
            break
        await asyncio.sleep(0.05)
    return {"states": states, "places": places}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(asyncio.run(move() if sys.argv[1] == "move" else lose(int(sys.argv[2])))))
