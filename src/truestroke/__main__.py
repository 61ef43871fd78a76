"""`truestroke`, and `python -m truestroke`: the command line, also where Ctrl-C comes while it loads."""

import os
import sys


def main() -> None:
    """Load the commands, and run the one that is asked for."""
    try:
        from truestroke.cli import main as commands
    except KeyboardInterrupt:
        os.write(2, b"truestroke: interrupted\n")
        sys.exit(130)
    commands(prog_name="truestroke")


if __name__ == "__main__":
    main()
