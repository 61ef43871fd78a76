"""What this computer has of what a run needs, what is missing, and the command that helps: `examine`."""

from truestroke.runtime.doctor.examination import examine
from truestroke.runtime.doctor.finding import Finding, Level

__all__ = ["Finding", "Level", "examine"]
