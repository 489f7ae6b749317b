"""Tasks: what observations mean, and what actions do."""

from rtagent.tasks.arm_stopping import ArmStopping
from rtagent.tasks.environment import EnvironmentTask
from rtagent.tasks.hallway import HallwayTask
from rtagent.tasks.signals import Signals
from rtagent.tasks.stopping import Stopping
from rtagent.tasks.switchboard import Switchboard

__all__ = ["ArmStopping", "EnvironmentTask", "HallwayTask", "Signals", "Stopping", "Switchboard"]
