"""The loop in real time on the simulated stack for half an hour: lateness, memory, lost samples.

    python benchmarks/soak.py [--minutes 30] [--cpu N] [--spin S] [--json]

Runs `truestroke run` and looks at the memory of its processes every few seconds. Ends with 1 if memory grows or a
sample is lost; lateness is that of this machine, and is reported only.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

WARM = 15.0  # s until all buffers have been used once
GROWTH = 2.0  # MB that a process may take more at the end
CONFIG = """
[driver]
name = "simulated"
[[axis]]
stroke = 30.0
voltage_limits = [-0.6, 3.6]
slew = 400.0
[axis.trajectory]
kind = "sine"
frequency = 7.0
duration = {seconds}
[realtime]
overrun_streak = 0
watchdog_timeout = 30.0
{more}
[recording]
file = "{file}"
"""


def memory(pid):
    """Resident memory of its own of a process and of those that it started, MB."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    found = {}
    for number, process in enumerate([str(pid), *children]):
        _, resident, shared = Path(f"/proc/{process}/statm").read_text().split()[:3]
        found[f"process {number}"] = (int(resident) - int(shared)) * 4096e-6
    return found


def soak(minutes, cpu, spin):
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.h5"
        more = "\n".join(f"{name} = {value}" for name, value in {"cpu": cpu, "spin": spin}.items() if value is not None)
        config = Path(folder) / "soak.toml"
        config.write_text(CONFIG.format(seconds=60.0 * minutes, more=more, file=file))
        command = [Path(sys.executable).with_name("truestroke"), "run", "--config", config, "--json"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        used, began = [], time.monotonic()
        while time.monotonic() - began < 60.0 * minutes:
            time.sleep(min(5.0, 5.0 * minutes))
            if process.poll() is not None:
                break
            if time.monotonic() - began > WARM:
                used.append(memory(process.pid))
        printed, _ = process.communicate()
        size = file.stat().st_size * 1e-6
    outcome = json.loads(printed)
    growth = {name: used[-1][name] - used[0][name] for name in used[0]} if len(used) > 1 else {}
    return outcome, growth, size


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--cpu", type=int)
    parser.add_argument(
        "--spin", type=float, help="s before a tick to wake up and spin; left out: that of truestroke run"
    )
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    outcome, growth, size = soak(options.minutes, options.cpu, options.spin)
    lost = outcome["lost"] + outcome["all_ticks"] - outcome["ticks"]
    good = not lost and outcome["exit_code"] == 0 and bool(growth) and max(growth.values()) < GROWTH
    if options.json:
        print(json.dumps({"good": good, "growth_mb": growth, "lost": lost, "file_mb": size, **outcome}))
    else:
        late = ", ".join(f"{name} {us:.1f} us" for name, us in outcome["lateness_us"].items())
        print(f"{outcome['ticks']} ticks; late: {late}")
        print(f"{outcome['overruns']} overruns, {outcome['missed']} periods missed")
        print("memory growth: " + ", ".join(f"{name} {mb:+.2f} MB" for name, mb in growth.items()))
        print(f"lost: {lost} samples; recording: {size:.0f} MB")
        print(f"true rmse {1e3 * outcome['axes']['axis']['true_rmse_um']:.1f} nm; {'good' if good else 'NOT GOOD'}")
    return not good


if __name__ == "__main__":
    sys.exit(main())
