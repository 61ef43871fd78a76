"""The loop on hardware, in real time: `run_realtime`.

The loop has a process for itself. Recorder, watchdog, status line and server are other processes that read a ring of
shared memory: neither their work nor their failure takes time from a tick.
"""

from truestroke.base import lazy

# The processes beside the loop need little of it, and each would load all of it.
__getattr__, __dir__, __all__ = lazy.attach(__name__)
