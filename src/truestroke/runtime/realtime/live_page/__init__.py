"""The run as a page in a browser: what it does now, and buttons for hold, set-point and STOP.

The page is served by a process of its own, which reads what the loop writes and cannot touch the tick. Nothing leaves
the computer unless the settings say so; only who has the token of control can change anything.
"""

from truestroke.runtime.realtime.live_page.settings import LiveSettings

__all__ = ["LiveSettings"]
