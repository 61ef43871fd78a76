"""bluesky flies an axis of `truestroke serve --epics` and stops the run: its documents as JSON."""

from __future__ import annotations

import asyncio
import json
import sys
from typing import Any

import bluesky.plan_stubs as bps
from bluesky import RunEngine
from bluesky.run_engine import call_in_bluesky_event_loop
from ophyd_async.core import init_devices
from scanspec.specs import Line

from truestroke.dropins.ophyd import EpicsPiezoAxis, fly


async def stopped(x: EpicsPiezoAxis) -> list[Any]:
    """How a flight of 5 s ends that is stopped, and where."""
    await x.prepare(0.5 @ Line("x", 8.0, 12.0, 10))
    await x.kickoff()
    going = x.complete()
    while await x.desired.get_value() < 8.5:
        await asyncio.sleep(0.01)
    await x.stop()
    try:
        await going
    except RuntimeError as error:
        return [str(error), await x.desired.get_value(), await x.speed.get_value() == await x.fastest()]
    return []


def main() -> None:
    engine = RunEngine(context_managers=[])
    with init_devices(timeout=30.0):
        x = EpicsPiezoAxis("TEST:STAGE:X")
    pages: list[dict[str, Any]] = []
    keys: dict[str, Any] = {}
    engine.subscribe(lambda _, document: pages.append(document["data"]), "event_page")
    engine.subscribe(lambda _, document: keys.update(document["data_keys"]), "descriptor")
    engine(fly(x, 0.02 @ Line("x", 8.0, 12.0, 5)))
    engine(fly(x, 0.05 @ Line("x", 12.0, 8.0, 5)))
    refused = ""
    try:
        engine(bps.prepare(x, 0.001 @ Line("x", 8.0, 12.0, 5), wait=True))
    except Exception as error:  # FailedStatus, whose cause says why
        refused = str(error.__cause__ or error)
    ended = call_in_bluesky_event_loop(stopped(x), 30.0)
    sys.stdout.write(json.dumps({"pages": pages, "keys": keys, "refused": refused, "stopped": ended}) + "\n")


if __name__ == "__main__":
    main()
