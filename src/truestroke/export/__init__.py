"""The controller for other machines: C source that builds by itself, settings for a browser, FMUs."""

from truestroke.export.c_source import Exported, export_c
from truestroke.export.fmu import CompilerError, export_fmu
from truestroke.export.json_settings import export_json

__all__ = ["CompilerError", "Exported", "export_c", "export_fmu", "export_json"]
