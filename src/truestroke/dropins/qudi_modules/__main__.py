"""`python -m truestroke.dropins.qudi_modules`: the line for the configuration of qudi."""

from pathlib import Path

print(f"extension_paths: ['{Path(__file__).parent}']")  # noqa: T201 (it is run for this)
