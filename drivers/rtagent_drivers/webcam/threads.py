"""A call that may block, in a thread of its own that nobody has to wait for."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import TypeVar, TypeVarTuple

T = TypeVar("T")
Ts = TypeVarTuple("Ts")


def in_thread(function: Callable[[*Ts], T], *arguments: *Ts) -> asyncio.Future[T]:
    """Call `function` in a thread, and return a future of what it returns or raises.

    A call that never returns does not keep the program from ending, as one in an executor's thread would.
    """
    loop = asyncio.get_running_loop()
    future: asyncio.Future[T] = loop.create_future()

    def work() -> None:
        try:
            result = function(*arguments)
        except Exception as error:
            tell(loop, _fail, future, error)
        else:
            tell(loop, _succeed, future, result)

    threading.Thread(target=work, name="webcam", daemon=True).start()
    return future


def tell(loop: asyncio.AbstractEventLoop, callback: Callable[[*Ts], object], *arguments: *Ts) -> bool:
    """Have the loop make a call, from a thread; return whether it can still be made."""
    try:
        loop.call_soon_threadsafe(callback, *arguments)
    except RuntimeError:  # it was closed meanwhile
        return False
    return True


def _succeed(future: asyncio.Future[T], result: T) -> None:
    if not future.done():
        future.set_result(result)


def _fail(future: asyncio.Future[T], error: Exception) -> None:
    if not future.done():
        future.set_exception(error)
        future.exception()  # seen: whoever waited for it may have gone
