"""The live view: a page of our own, fed by a run's telemetry; see docs/view.md."""
