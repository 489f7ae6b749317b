"""Learners: linear in their features, one update for each transition."""

from rtagent.learning.control import ExpectedSarsa, QLearning, Sarsa
from rtagent.learning.demons import Continuation, Demon, Demons, Method
from rtagent.learning.horde import Horde
from rtagent.learning.learner import ControlLearner, Inheriting, Learner, PredictionLearner, SlicedLearner, Verified
from rtagent.learning.off_policy import GTD
from rtagent.learning.prediction import TD
from rtagent.learning.swift import SwiftTD
from rtagent.learning.true_online import TrueOnlineSarsa, TrueOnlineTD
from rtagent.learning.with_horde import WithHorde

__all__ = [
    "GTD",
    "TD",
    "Continuation",
    "ControlLearner",
    "Demon",
    "Demons",
    "ExpectedSarsa",
    "Horde",
    "Inheriting",
    "Learner",
    "Method",
    "PredictionLearner",
    "QLearning",
    "Sarsa",
    "SlicedLearner",
    "SwiftTD",
    "TrueOnlineSarsa",
    "TrueOnlineTD",
    "Verified",
    "WithHorde",
]
