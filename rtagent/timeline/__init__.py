"""The timeline of a run, which Perfetto (https://ui.perfetto.dev) and chrome://tracing open."""

from rtagent.timeline.recording import Timeline
from rtagent.timeline.trace_events import write

__all__ = ["Timeline", "write"]
