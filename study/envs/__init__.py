"""The real systems. Importing the module of a system registers it."""

from study.data.symmetries import Mirror, Shift, Symmetries, Turn
from study.data.variables import Constant, Variable
from study.envs import pusher, uav
from study.envs.registration import gymnasium_id, register
from study.envs.simulator import Episode, Policy, Rollout, Scenarios, Simulator, simulators

__all__ = [
    "Constant",
    "Episode",
    "Mirror",
    "Policy",
    "Rollout",
    "Scenarios",
    "Shift",
    "Simulator",
    "Symmetries",
    "Turn",
    "Variable",
    "gymnasium_id",
    "pusher",
    "register",
    "simulators",
    "uav",
]
