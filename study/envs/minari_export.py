"""Export an environment's training trajectories as a Minari data set.

    python -m study.run export pusher

An episode has the observations, actions, rewards and ends that stepping `SimulatorEnv` through the
trajectory gives. `study.data.minari` says what the data set holds.
"""

from dataclasses import dataclass
from pathlib import Path

import gymnasium

from study.common.errors import BadInput
from study.common.progress import Progress
from study.config.settings import Collect, Config
from study.data.minari import DataSet, create_parents, new_data_set, write
from study.data.trajectories import Trajectories, concatenate
from study.envs.check import check_foreign
from study.envs.gymnasium_env import SimulatorEnv
from study.envs.observe import observe_training, real_system, trajectory_seeds
from study.envs.registration import gymnasium_id


@dataclass(frozen=True)
class Export:
    """The export of one environment's training trajectories.

    Attributes:
        environment: registered name.
        collect: settings of the data.
        data_set: name and location.
    """

    environment: str
    collect: Collect
    data_set: DataSet

    def write(self, progress: Progress) -> Trajectories:
        """Simulate the training trajectories, as the stage collect does, and write them.

        Raises:
            BadInput: the folder cannot be written.
        """
        try:
            create_parents(self.data_set)
            parts = observe_training(self.environment, self.collect, progress.part(0.0, 0.7))
            trajectories = concatenate(parts)
            self._write(trajectories)
        except OSError as error:
            root = self.data_set.root
            raise BadInput(f"--to: cannot write to '{root}': {error}") from error
        return trajectories

    def _write(self, trajectories: Trajectories) -> None:
        simulator, _ = real_system(self.environment, self.collect)
        seeds = trajectory_seeds(trajectories.facts["seed"], len(trajectories))
        made = gymnasium.make(gymnasium_id(type(simulator)), horizon=trajectories.horizon)
        environment = made.unwrapped
        assert isinstance(environment, SimulatorEnv)
        write(
            self.data_set,
            made,
            simulator.title,
            environment.transitions(trajectories),
            [
                {"scenario": scenario, "noise": noise}
                for scenario, noise in zip(*seeds, strict=True)
            ],
            trajectories.unobserved,
            trajectories.facts,
        )
        made.close()


def prepare(config: Config, environment: str, root: Path | None = None) -> Export:
    """Check that an export can be written, before anything is simulated.

    The data set is named after the environment, the configuration and the environment's version.

    Args:
        config: names the data set, and says what is simulated.
        environment: registered name.
        root: folder of Minari data sets; None is Minari's own (``MINARI_DATASETS_PATH``).

    Raises:
        BadInput: the environment is unknown, the data set exists, or Minari does not allow a data
            set with the configuration's name.
        StudyError: Minari is not installed, or the class does not do what the study relies on.
    """
    simulator, _ = real_system(environment, config.collect)
    identifier = f"study/{environment}/{config.name}-v{simulator.version}"
    data_set = new_data_set(identifier, root)
    check_foreign(type(simulator), config.collect.horizon)
    return Export(environment, config.collect, data_set)
