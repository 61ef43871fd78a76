"""What this computer has of what a run needs, what is missing, and the command that helps: `examine`."""

from truestroke.doctor.examination import examine
from truestroke.doctor.finding import Finding, Level

__all__ = ["Finding", "Level", "examine"]
