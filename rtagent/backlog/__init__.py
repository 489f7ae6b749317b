"""Learning as work in a queue: when, in what slices and where transitions are learned."""

from rtagent.backlog.backlog import Backlog, Desk, Update
from rtagent.backlog.elsewhere import Elsewhere
from rtagent.backlog.in_loop import Inline, InLoop, yield_once
from rtagent.backlog.work import Work, make_work

__all__ = ["Backlog", "Desk", "Elsewhere", "InLoop", "Inline", "Update", "Work", "make_work", "yield_once"]
