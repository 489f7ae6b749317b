"""Zenoh sessions: clients of one small router, which is started where none listens yet."""

from __future__ import annotations

import contextlib
import json
import re
import socket
import subprocess
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import msgspec

from rtagent.errors import RtagentError

if TYPE_CHECKING:
    from zenoh import Config, Session

ENDPOINT = "tcp/127.0.0.1:7447"
TIMEOUT = 3000
"""How long (ms) a session may take to be there."""
LOCAL = ("127.0.0.1", "localhost", "[::1]")


class TelemetryError(RtagentError):
    """Telemetry cannot be sent, received, written or read; says what to do."""


class Access(msgspec.Struct, frozen=True):
    """Where telemetry goes, and with which credentials; all but `endpoint` may be empty.

    `password_file` holds the password of `user`, `ca` the certificate of the authority that is trusted. A router
    that is started here listens at `endpoint` and `listen`, with `certificate` and `key`, for the users of the file
    `users`, user:password on each line.
    """

    endpoint: str = ENDPOINT
    listen: tuple[str, ...] = ()
    user: str = ""
    password_file: str = ""
    ca: str = ""
    certificate: str = ""
    key: str = ""
    users: str = ""

    @property
    def can_be_started(self) -> bool:
        """Whether a router could be started at the endpoint: on this machine, with all that it needs."""
        protocol, _, address = self.endpoint.partition("/")
        return address.rsplit(":", 1)[0] in LOCAL and (protocol == "tcp" or bool(self.certificate and self.key))


def zenoh_module() -> Any:
    """Return the module zenoh; raise `TelemetryError` where it is not installed."""
    try:
        import zenoh
    except ImportError:
        raise TelemetryError("telemetry needs the package eclipse-zenoh: pip install eclipse-zenoh.") from None
    return zenoh


def open_client(access: Access) -> Session:
    """Return a session; a local router that is missing is started. Raises `TelemetryError`."""
    zenoh = zenoh_module()
    _check(access.endpoint)
    if not _listens(access.endpoint):
        if not access.can_be_started:
            raise TelemetryError(f"nothing listens at {access.endpoint}: start a run there, or give another one.")
        _start_router(access)
    settings = _common(access) | {
        "mode": "client",
        "connect/endpoints": [access.endpoint],
        "connect/timeout_ms": TIMEOUT,
        "connect/exit_on_failure": True,
        "connect/retry": {"period_init_ms": 500, "period_max_ms": 1000, "period_increase_factor": 2},
    }
    try:
        session: Session = zenoh.open(config(settings))
    except zenoh.ZError as error:
        raise TelemetryError(
            f"{access.endpoint} lets nobody in as {access.user or 'no user'}: see that user, password and "
            f"certificates are right (Zenoh says: {reason(error)})."
        ) from None
    return session


def router_settings(access: Access) -> Mapping[str, Any]:
    """Return the settings of a router that listens where `access` says."""
    settings = _common(access) | {"mode": "router", "listen/endpoints": [access.endpoint, *access.listen]}
    settings["listen/exit_on_failure"] = True
    if access.certificate:
        settings["transport/link/tls/listen_certificate"] = access.certificate
        settings["transport/link/tls/listen_private_key"] = access.key
    if access.users:
        settings["transport/auth/usrpwd/dictionary_file"] = access.users
    return settings


def config(settings: Mapping[str, Any]) -> Config:
    """Return Zenoh's configuration; keys are paths into it."""
    made: Config = zenoh_module().Config()
    for key, value in settings.items():
        made.insert_json5(key, json.dumps(value))
    return made


def _common(access: Access) -> dict[str, Any]:
    settings: dict[str, Any] = {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/queue/size/data": 16,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
    }
    if access.ca:
        settings["transport/link/tls/root_ca_certificate"] = access.ca
    if access.user:
        settings["transport/auth/usrpwd/user"] = access.user
        settings["transport/auth/usrpwd/password"] = _password(access.password_file)
    return settings


def _password(path: str) -> str:
    try:
        with open(path, encoding="utf-8") as file:  # noqa: PTH123  # the sender starts without pathlib
            return file.readline().rstrip("\r\n")
    except OSError as error:
        raise TelemetryError(f"the password is not read: {error}. Give password_file.") from None


def _check(endpoint: str) -> None:
    if not re.fullmatch(r"(tcp|tls|quic)/[^/]+:\d+([?#].*)?", endpoint):
        raise TelemetryError(f"{endpoint!r} is no endpoint: write one as tcp/127.0.0.1:7447.")


def _listens(endpoint: str) -> bool:
    host, _, port = endpoint.split("/", 1)[1].split("?")[0].rpartition(":")
    with contextlib.suppress(OSError), socket.create_connection((host.strip("[]"), int(port)), 0.5):
        return True
    return False


def _start_router(access: Access) -> None:
    """Start a router of its own, that outlives this process, and wait until it listens or has failed."""
    command = [sys.executable, "-m", "rtagent.telemetry.router", json.dumps(msgspec.to_builtins(access))]
    with subprocess.Popen(  # noqa: S603  # our own program
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True
    ) as router:
        said = router.stdout.readline().decode().strip() if router.stdout else ""
        router.returncode = 0  # it is not waited for
    if said != "ready" and not _listens(access.endpoint):
        raise TelemetryError(f"no router could be started at {access.endpoint}: {said or 'it said nothing'}")


def reason(error: Exception) -> str:
    """Return why Zenoh failed, without the places in its source."""
    return re.sub(r"( at|\.)* \S*\.rs:\d+\.?", "", str(error).splitlines()[0]).rstrip(".")
