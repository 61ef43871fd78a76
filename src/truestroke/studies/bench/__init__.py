"""What a step costs on this machine, beside what others offer and beside the machine's limit."""

from truestroke.studies.bench.cost import Cost
from truestroke.studies.bench.suite import run

__all__ = ["Cost", "run"]
