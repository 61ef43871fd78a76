"""What every test finds: Ctrl-C ends a process, also where a shell that runs in the background has it ignored."""

import signal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # children inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)
