"""Training data in the format that offline-RL users share, Minari (https://minari.farama.org).

    python -m study.run export pusher

In our own format or in Minari's, a data set loads in one line::

    trajectories = Trajectories.load(Path("results/quick/work/collect/…/train.safetensors"))
    dataset = minari.load_dataset("study/pusher/quick-v2")

An episode is a trajectory as `SimulatorEnv` would have given it: the same observations, actions,
rewards and ends. ``dataset.recover_environment()`` makes that environment, and nothing need be
imported for it but what a `--plugins` of one's own registers. Metadata of an episode hold the
``options`` with which ``reset`` begins that very trajectory, and ``unobserved`` [H], what acted on it.
Metadata of the data set hold under ``study`` the facts of `Trajectories`: names, units, seed and
versions; and the SHA-256 of the data file.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from study.common.arrays import Booleans, Doubles, Floats
from study.common.errors import BadInput, StudyError
from study.common.files import sha256
from study.common.progress import Progress
from study.config.settings import Config
from study.data.trajectories import Trajectories, joined
from study.envs import Simulator, gymnasium_id
from study.envs.gymnasium_env import SimulatorEnv
from study.envs.observe import observe_training, real_system, trajectory_seeds

DESCRIPTION = """\
Trajectories of {environment}: a policy plans each on the noise-free system, and the noisy one \
executes the plan open loop. Observations are the state, then the goal, in the units given under \
"study"; actions are scaled to -1 and 1 at their bounds; the reward is 1 at the step at which the \
goal first succeeds. Each episode's metadata have the options of `reset` that begin it again."""


@dataclass(frozen=True)
class Transitions:
    """N trajectories as an agent would have met them.

    Attributes:
        observations: [N, T+1, D + G] float32.
        actions: [N, T, A] float64, between -1 and 1.
        rewards: [N, T] float64.
        terminations: [N, T].
        truncations: [N, T].
    """

    observations: Floats
    actions: Doubles
    rewards: Doubles
    terminations: Booleans
    truncations: Booleans


@dataclass(frozen=True)
class Export:
    """The training trajectories of one environment, on their way to a Minari data set.

    Attributes:
        id: Minari's name for it: ``study/pusher/quick-v2``, of the environment, the configuration
            and the version of the environment's numbers.
        root: folder of Minari data sets.
        settings: of the stage collect.
    """

    id: str
    root: Path
    settings: dict[str, Any]

    @property
    def folder(self) -> Path:
        """Where it will be."""
        return self.root / self.id

    def write(self, progress: Progress) -> Trajectories:
        """Simulate the trajectories, those that the stage collect observes, and write them.

        The data set appears under its name only when it is whole.

        Args:
            progress: told how far it is.

        Raises:
            BadInput: the folder cannot be written.
        """
        simulator, _ = real_system(self.settings)
        try:
            _make_namespaces(self.folder)
            trajectories = joined(observe_training(self.settings, progress.part(0.0, 0.7)))
            # Minari does not list a folder whose name begins with a dot.
            with tempfile.TemporaryDirectory(prefix=".", dir=self.folder.parent) as place:
                new = Path(place, self.folder.name)
                new.mkdir()
                _write_data(new / "data", self.id, simulator, trajectories)
                new.rename(self.folder)
        except OSError as error:
            raise BadInput(f"--to: cannot write to '{self.root}': {error}") from error
        return trajectories


def prepare(config: Config, environment: str, root: Path | None = None) -> Export:
    """Look at all that can be wrong with an export, before anything is simulated.

    Args:
        root: folder of Minari data sets; None is Minari's own (``MINARI_DATASETS_PATH``).

    Raises:
        BadInput: the environment is unknown, the data set is there already, or Minari cannot name
            one after the configuration.
        StudyError: Minari is not installed.
    """
    settings = {"environment": environment, "collect": asdict(config.collect)}
    simulator, _ = real_system(settings)
    try:
        import h5py  # noqa: F401
        import minari  # noqa: F401
        from minari.dataset.minari_dataset import parse_dataset_id
        from minari.storage import get_dataset_path
    except ImportError:
        raise StudyError("Minari is not installed: pip install -e '.[minari]'") from None
    identifier = f"study/{environment}/{config.name}-v{simulator.version}"
    try:
        parse_dataset_id(identifier)
    except ValueError:
        raise BadInput(
            f"name: got '{config.name}'; a Minari data set's has letters, digits, - and _ alone"
        ) from None
    export = Export(identifier, (root or get_dataset_path()).absolute(), settings)
    if export.folder.exists():
        raise BadInput(
            f"{export.folder} is there already; remove it, or give another --name or --to"
        )
    return export


def transitions(environment: SimulatorEnv, trajectories: Trajectories) -> Transitions:
    """What stepping `environment` through each of `trajectories` would have given."""
    states, goal = trajectories.states, trajectories.goal
    count, horizon = trajectories.actions.shape[:2]
    repeated = np.broadcast_to(goal[:, None], (count, horizon + 1, goal.shape[-1]))
    # Of each state alone, as a trajectory of one step: [N, T].
    reached = environment.simulator.outcome(states[:, 1:, None], goal[:, None])
    truncations = np.zeros((count, horizon), np.bool_)
    truncations[:, -1] = True
    return Transitions(
        observations=np.concatenate([states, repeated], axis=-1),
        actions=environment.scaled(trajectories.actions),
        rewards=(reached & (reached.cumsum(axis=1) == 1)).astype(np.float64),
        terminations=np.zeros((count, horizon), np.bool_),
        truncations=truncations,
    )


def _write_data(
    folder: Path, identifier: str, simulator: Simulator, trajectories: Trajectories
) -> None:
    import minari
    from minari.dataset.minari_storage import MinariStorage

    wrapped = gymnasium.make(gymnasium_id(type(simulator)), horizon=trajectories.horizon)
    environment = wrapped.unwrapped
    assert isinstance(environment, SimulatorEnv)
    storage = MinariStorage.new(
        folder,
        observation_space=wrapped.observation_space,
        action_space=wrapped.action_space,
        env_spec=wrapped.spec,
        data_format="hdf5",  # what every version of Minari reads
    )
    storage.update_episodes(_episodes(transitions(environment, trajectories), trajectories))
    storage.update_episode_metadata(
        {"unobserved": unobserved} for unobserved in trajectories.unobserved
    )
    checksums = {path.name: sha256(path) for path in folder.glob("*.hdf5")}
    storage.update_metadata(
        {
            "dataset_id": identifier,
            "minari_version": minari.__version__,
            "description": DESCRIPTION.format(environment=simulator.title),
            "algorithm_name": "planned on the noise-free system, executed open loop",
            "requirements": [f"mujoco=={trajectories.facts['versions']['mujoco']}"],
            "study": trajectories.facts | {"sha256": checksums},
        }
    )
    wrapped.close()


def _episodes(steps: Transitions, trajectories: Trajectories) -> Iterator[Any]:
    from minari.data_collector.episode_buffer import EpisodeBuffer

    seeds = trajectory_seeds(trajectories.facts["seed"], len(trajectories))
    for row, (scenario, noise) in enumerate(zip(*seeds, strict=True)):
        yield EpisodeBuffer(
            options={"scenario": scenario, "noise": noise},
            observations=steps.observations[row],
            actions=steps.actions[row],
            rewards=steps.rewards[row],
            terminations=steps.terminations[row],
            truncations=steps.truncations[row],
        )


def _make_namespaces(folder: Path) -> None:
    """The two folders above a data set, as Minari makes them."""
    from minari.namespace import NAMESPACE_METADATA_FILENAME

    for parent in (folder.parent, folder.parent.parent):
        parent.mkdir(parents=True, exist_ok=True)
        about = parent / NAMESPACE_METADATA_FILENAME
        if not about.exists():
            about.write_text("{}")
