"""The controller for other machines: C source that builds by itself, settings for the module of a browser."""

from truestroke.export.c_source import Exported, export_c
from truestroke.export.json_settings import export_json

__all__ = ["Exported", "export_c", "export_json"]
