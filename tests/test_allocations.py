"""Neither a tick nor a block of ticks asks for memory: every malloc of the process is counted."""

import os
import shutil
import subprocess
import sys

import pytest

COUNTER = """
#include <stddef.h>
void *__libc_malloc(size_t); void *__libc_calloc(size_t, size_t); void *__libc_realloc(void *, size_t);
long allocations;
void *malloc(size_t n) { allocations++; return __libc_malloc(n); }
void *calloc(size_t k, size_t n) { allocations++; return __libc_calloc(k, n); }
void *realloc(void *p, size_t n) { allocations++; return __libc_realloc(p, n); }
"""

SCRIPT = """
import ctypes, sys
import numpy as np
from truestroke import AdaptiveController, ControllerSettings

count = ctypes.c_long.in_dll(ctypes.CDLL(sys.argv[1]), "allocations")
bench = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
t = np.arange(4000) / 2000.0
z_d, zdot_d = 15.0 - 14.0 * np.cos(40.0 * t), 560.0 * np.sin(40.0 * t)
z = z_d + 0.3 * np.sin(7.0 * t)
z[::50], z[2000:] = np.nan, 0.8 * z[2000:]  # lost ones, and a change

def ticks(command, adapt, samples):
    before = count.value
    for a, b, c in samples:
        command(a, b)
        adapt(c)
    return count.value - before

def block(kernel, length, volts):
    before = count.value
    kernel.process(z_d[:length], zdot_d[:length], z[:length], volts[:length], 0)
    return count.value - before

for settings in ControllerSettings.paper(**bench), ControllerSettings(**bench):
    controller = AdaptiveController.from_settings(settings)
    samples = list(zip(z_d.tolist(), zdot_d.tolist(), z.tolist()))
    ticks(controller.command, controller.adapt, samples[:10]), block(controller._kernel, 10, np.empty_like(z_d))
    few = ticks(controller.command, controller.adapt, samples[:10])  # the iterator and the count itself
    print(ticks(controller.command, controller.adapt, samples) - few)
    print(block(controller._kernel, 4000, np.empty_like(z_d)) - block(controller._kernel, 1, np.empty_like(z_d)))
before = count.value
kept = [float(i) for i in range(1000)]
print(count.value - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux") or not shutil.which("cc"), reason="needs glibc and a compiler")
def test_no_tick_and_no_block_asks_for_memory(tmp_path) -> None:
    source, counter = tmp_path / "counter.c", tmp_path / "counter.so"
    source.write_text(COUNTER)
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", counter, source], check=True)
    everything = {"LD_PRELOAD": str(counter), "PYTHONMALLOC": "malloc"}  # Python's own objects too
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, counter], env=os.environ | everything, capture_output=True, text=True, check=True
    )
    *ours, counted = (int(word) for word in done.stdout.split())
    assert ours == [0, 0, 0, 0]
    assert counted >= 1000  # the counter counts
