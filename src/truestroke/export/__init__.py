"""The controller for other machines: C source that builds by itself."""

from truestroke.export.c_source import Exported, export_c

__all__ = ["Exported", "export_c"]
