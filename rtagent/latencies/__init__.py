"""Latency as a test: how long runs take to react, compared with limits, with a floor, and with one another."""

from rtagent.latencies.comparison import Comparison, Ratio
from rtagent.latencies.counts import Counts
from rtagent.latencies.host import Disturbance
from rtagent.latencies.rounds import Rules
from rtagent.latencies.subject import Subject
from rtagent.latencies.times import Measured, Times

__all__ = ["Comparison", "Counts", "Disturbance", "Measured", "Ratio", "Rules", "Subject", "Times"]
