"""Learners: linear in their features, one update for each transition."""

from rtagent.learning.control import ExpectedSarsa, QLearning, Sarsa
from rtagent.learning.learner import ControlLearner, Learner, PredictionLearner
from rtagent.learning.off_policy import GTD
from rtagent.learning.prediction import TD
from rtagent.learning.swift import SwiftTD
from rtagent.learning.true_online import TrueOnlineSarsa, TrueOnlineTD

__all__ = [
    "GTD",
    "TD",
    "ControlLearner",
    "ExpectedSarsa",
    "Learner",
    "PredictionLearner",
    "QLearning",
    "Sarsa",
    "SwiftTD",
    "TrueOnlineSarsa",
    "TrueOnlineTD",
]
