"""Replay: what was recorded of a run, through the same agent again, or through another one."""
