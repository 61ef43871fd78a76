"""Lists the members of a C struct, those of structs within it too: MEMBER("kalman.filter", kalman.filter) a line.

    python members.py truestroke.h ts_settings ts_settings.inc

so that the binding copies settings by name, whatever members the header has.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path


def members(header: str, struct: str, prefix: str = "") -> Iterator[str]:
    """Paths of the members of a struct, in order."""
    (body,) = re.findall(rf"typedef struct \{{([^}}]*)\}} {struct};", header)
    for kind, names in re.findall(r"(\w+) ([^;]+);", body):
        for name in re.findall(r"(\w+)(?:\[[^]]*\])*(?:,|$)", names):
            within = re.search(rf"\}} {kind};", header) and kind != "ts_law"
            yield from members(header, kind, f"{prefix}{name}.") if within else [prefix + name]


if __name__ == "__main__":
    text = re.sub(r"/\*.*?\*/", "", Path(sys.argv[1]).read_text(encoding="utf-8"), flags=re.DOTALL)
    lines = (f'MEMBER("{path}", {path})\n' for path in members(text, sys.argv[2]))
    listed, file = "".join(lines), Path(sys.argv[3])
    if not file.exists() or file.read_text(encoding="utf-8") != listed:  # else the bindings would be compiled again
        file.write_text(listed, encoding="utf-8")
