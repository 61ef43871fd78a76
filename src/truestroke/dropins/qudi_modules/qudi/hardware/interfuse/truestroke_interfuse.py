"""What qudi imports: `module.Class: 'interfuse.truestroke_interfuse.InversePiezoInterfuse'`."""

from truestroke.dropins.qudi import InversePiezoInterfuse

__all__ = ["InversePiezoInterfuse"]
