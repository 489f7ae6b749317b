"""`python -m rtagent.watchdog`: started by the runtime, which talks to its standard input and output."""

import os

from rtagent.watchdog.guard import main

main()
os._exit(0)  # whatever still hangs in a thread
