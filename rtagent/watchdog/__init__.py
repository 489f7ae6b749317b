"""The watchdog: a process of its own that makes devices safe when the runtime dies or stalls.

`process` is the runtime's side of it, `guard` what the process does (`python -m rtagent.watchdog`),
`resorts` how a device is made safe without an event loop. They talk in lines: the runtime sends what to guard,
then an empty line for each heartbeat, `stop` and `end`; the watchdog answers with JSON.
"""
