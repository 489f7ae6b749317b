"""A port in memory for the unmodified dynamixel-sdk: what it sends is kept, what it reads is given beforehand."""

from __future__ import annotations


class MemoryPort:
    """What the SDK's packet handlers ask of a `PortHandler`; time runs out once there is nothing more to read."""

    def __init__(self) -> None:
        self.is_using = False
        self.sent = b""
        self._incoming = b""

    def will_receive(self, data: bytes) -> None:
        self._incoming = data

    def clearPort(self) -> None:  # noqa: N802 (the names are the SDK's)
        pass

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        self.sent = bytes(packet)
        return len(packet)

    def readPort(self, length: int) -> bytes:  # noqa: N802
        taken, self._incoming = self._incoming[:length], self._incoming[length:]
        return taken

    def setPacketTimeout(self, length: int) -> None:  # noqa: N802
        pass

    def setPacketTimeoutMillis(self, milliseconds: float) -> None:  # noqa: N802
        pass

    def isPacketTimeout(self) -> bool:  # noqa: N802
        return not self._incoming

    def getBaudRate(self) -> int:  # noqa: N802
        return 1_000_000

    def take(self) -> bytes:
        """Return what was sent last, and be free for the next."""
        self.is_using = False
        sent, self.sent = self.sent, b""
        return sent
