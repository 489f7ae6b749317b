"""Telemetry: everything that a run knows, watched from elsewhere and recorded; see docs/telemetry.md."""
