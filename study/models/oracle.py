"""The oracle: the simulator itself as a forecaster, whose forecasts no model can improve."""

from dataclasses import dataclass

import numpy as np

from study.common.arrays import Floats
from study.common.progress import Progress
from study.common.seeds import Seeds
from study.envs import Simulator
from study.envs.observe import repeat_rollouts


@dataclass(frozen=True)
class Oracle:
    """The simulator as a forecaster: it simulates the actions from s_0 with new noise.

    Attributes:
        simulator: the system that also produced the observations.
    """

    simulator: Simulator

    def forecast(self, s0: Floats, actions: Floats, samples: int, seeds: Seeds) -> Floats:
        """See `Forecaster.forecast`."""
        parts = repeat_rollouts(self.simulator, s0, actions, samples, seeds, Progress())
        return np.concatenate([states for states, _ in parts])
