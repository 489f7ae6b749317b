"""Endpoints that cannot be are refused with a sentence, before anything is opened or started."""

from __future__ import annotations

import pytest

from rtagent.telemetry.connection import Access, TelemetryError, open_client


@pytest.mark.parametrize(
    "endpoint", ["nonsense", "tcp/127.0.0.1", "127.0.0.1:7447", "udp/127.0.0.1:7447", "tcp/:x"]
)
def test_what_is_no_endpoint_is_told(endpoint: str) -> None:
    with pytest.raises(TelemetryError, match="is no endpoint: write one as"):
        open_client(Access(endpoint=endpoint))
