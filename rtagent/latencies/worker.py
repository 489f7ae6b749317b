"""Measures a scenario in a process of its own, whenever it is told to: see `Worker` in processes.py.

It is run as a script by the interpreter of another installation too, and measures the rtagent of that.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

Job = Callable[[], Any]
"""Something to measure; returns plain data for JSON."""


def main() -> None:
    """Serve the scenario, with keys set over it, that is given as arguments."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever asks is interrupted too, and ends this
    scenario, *keys = sys.argv[1:]
    serve(jobs_of(lambda: _subject(scenario, keys)))


def serve(jobs: Mapping[str, Job]) -> None:
    """Answer each line of standard input, the name of a job, by a line of JSON: what it came to, or its error."""
    with os.fdopen(os.dup(sys.stdout.fileno()), "w") as answers:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a device prints is no answer
        for line in sys.stdin:
            answers.write(json.dumps(_answer(jobs[line.strip()])) + "\n")
            answers.flush()


def jobs_of(make_subject: Callable[[], Any]) -> dict[str, Job]:
    """Return the jobs for a subject, which is made for the first of them."""
    subject = cache(make_subject)
    return {"times": lambda: _times(subject()), "exact": lambda: _exact(subject())}


def _answer(job: Job) -> dict[str, Any]:
    try:
        return {"done": job()}
    except Exception as error:  # it is for whoever asked
        return {"error": str(error) or repr(error), "kind": type(error).__name__}


def _subject(scenario: str, keys: list[str]) -> Any:
    from rtagent.latencies.subject import Subject

    return Subject.scenario(scenario, *keys)


def _times(subject: Any) -> Any:
    from rtagent.latencies.rounds import block_of

    return block_of(subject.run())


def _exact(subject: Any) -> Any:
    import msgspec

    from rtagent.latencies.figures import exact

    return msgspec.to_builtins(exact(subject))


if __name__ == "__main__":
    main()
