"""A wheel that is installed with numpy alone: it loads, and a short loop converges. Prints the kernel's variants.

Run by tests/wheel.py, and by .github/workflows on the systems that it builds for.
"""

from __future__ import annotations

import math
import sys

import truestroke

HEAVY = {"scipy", "h5py", "matplotlib", "rich", "click", "jinja2"}


def main() -> None:
    assert not HEAVY & set(sys.modules), HEAVY & set(sys.modules)
    c = truestroke.AdaptiveController(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    for k in range(2000):
        z_d = 15.0 - 14.0 * math.cos(0.02 * k)
        z = 10.0 * c.command(z_d, 560.0 * math.sin(0.02 * k))
        c.adapt(z)
    assert abs(z - z_d) < 0.05, (z, z_d)
    from truestroke import _kernel

    variants, python = ", ".join(_kernel.variants()), sys.version.split()[0]
    print(f"truestroke {truestroke.__version__} on Python {python} with numpy alone; kernel: {variants}")


if __name__ == "__main__":
    main()
