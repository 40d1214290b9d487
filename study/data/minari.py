"""Write a data set in the format of Minari, a library for offline RL (https://minari.farama.org).

`study.envs.minari_export` writes the training trajectories of an environment with it.

Reading a data set takes one line::

    dataset = minari.load_dataset("study/pusher/quick-v2")

``dataset.recover_environment()`` returns the environment. The metadata of an episode hold
``options``, with which ``reset`` begins the same trajectory, and ``unobserved`` [H]. The metadata
of the data set hold, under ``study``, the facts of `Trajectories` and the SHA-256 of the data file.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium

from study.common.arrays import Booleans, Doubles, Floats
from study.common.errors import BadInput, StudyError
from study.common.files import sha256

DESCRIPTION = """\
Trajectories of {environment}: a policy plans the actions of a trajectory on the noise-free \
system, and the noisy system executes them open loop. An observation is the state and then the \
goal, in the units given under "study". Actions are scaled so that their bounds are -1 and 1. The \
reward is 1 at the step at which the goal is first reached. The metadata of an episode hold the \
options with which `reset` begins the same trajectory."""


@dataclass(frozen=True)
class Transitions:
    """N trajectories of T steps, as ``gymnasium.Env.step`` returns them.

    Attributes:
        observations: [N, T+1, D + G] float32, the state and then the goal, in SI units.
        actions: [N, T, A] float64, between -1 and 1.
        rewards: [N, T] float64.
        terminations: [N, T], always False: the horizon alone ends an episode.
        truncations: [N, T], True at the last step.
    """

    observations: Floats
    actions: Doubles
    rewards: Doubles
    terminations: Booleans
    truncations: Booleans


@dataclass(frozen=True)
class DataSet:
    """The name and the location of a data set.

    Attributes:
        id: Minari's name for it, such as ``study/pusher/quick-v2``.
        root: folder of Minari data sets.
    """

    id: str
    root: Path

    @property
    def folder(self) -> Path:
        """The folder of the data set."""
        return self.root / self.id


def new_data_set(identifier: str, root: Path | None = None) -> DataSet:
    """Check that a data set can be written, before the simulation starts.

    Args:
        identifier: Minari's name for it.
        root: folder of Minari data sets; None is Minari's default (``MINARI_DATASETS_PATH``).

    Raises:
        BadInput: Minari does not allow the name, or the data set exists.
        StudyError: Minari is not installed.
    """
    try:
        import h5py  # noqa: F401
        import minari  # noqa: F401
        from minari.dataset.minari_dataset import parse_dataset_id
        from minari.storage import get_dataset_path
    except ImportError:
        raise StudyError("Minari is not installed: pip install -e '.[minari]'") from None
    try:
        parse_dataset_id(identifier)
    except ValueError:
        raise BadInput(
            f"name: got '{identifier}'; Minari allows letters, digits, - and _ in a name"
        ) from None
    data_set = DataSet(identifier, (root or get_dataset_path()).absolute())
    if data_set.folder.exists():
        raise BadInput(f"{data_set.folder} exists; remove it, or use another --name or --to")
    return data_set


def create_parents(data_set: DataSet) -> None:
    """Create the folders above a data set, which Minari calls namespaces."""
    from minari.namespace import NAMESPACE_METADATA_FILENAME

    for parent in (data_set.folder.parent, data_set.folder.parent.parent):
        parent.mkdir(parents=True, exist_ok=True)
        metadata = parent / NAMESPACE_METADATA_FILENAME
        if not metadata.exists():
            metadata.write_text("{}", encoding="utf-8")


def write(
    data_set: DataSet,
    environment: gymnasium.Env[Any, Any],
    title: str,
    transitions: Transitions,
    options: Sequence[dict[str, Any]],
    unobserved: Floats,
    facts: dict[str, Any],
) -> None:
    """Write a data set. The folder gets its final name when it is complete.

    Args:
        data_set: name and location; call `create_parents` first.
        environment: created by ``gymnasium.make``.
        title: name of the environment in text.
        transitions: of N trajectories.
        options: N options with which ``reset`` begins the same trajectories.
        unobserved: [N, H], the unobserved variables.
        facts: see `Trajectories.facts`.
    """
    import minari
    from minari.dataset.minari_storage import MinariStorage

    # Minari does not list a folder whose name begins with a dot.
    with tempfile.TemporaryDirectory(prefix=".", dir=data_set.folder.parent) as parent:
        folder = Path(parent, data_set.folder.name)
        (folder / "data").mkdir(parents=True)
        storage = MinariStorage.new(
            folder / "data",
            observation_space=environment.observation_space,
            action_space=environment.action_space,
            env_spec=environment.spec,
            data_format="hdf5",  # the format that every version of Minari reads
        )
        storage.update_episodes(_episodes(transitions, options))
        storage.update_episode_metadata({"unobserved": values} for values in unobserved)
        checksums = {path.name: sha256(path) for path in (folder / "data").glob("*.hdf5")}
        storage.update_metadata(
            {
                "dataset_id": data_set.id,
                "minari_version": minari.__version__,
                "description": DESCRIPTION.format(environment=title),
                "algorithm_name": "planned on the noise-free system, executed open loop",
                "requirements": [f"mujoco=={facts['versions']['mujoco']}"],
                "study": facts | {"sha256": checksums},
            }
        )
        folder.rename(data_set.folder)


def _episodes(transitions: Transitions, options: Sequence[dict[str, Any]]) -> Iterator[Any]:
    from minari.data_collector.episode_buffer import EpisodeBuffer

    for row, reset_options in enumerate(options):
        yield EpisodeBuffer(
            options=reset_options,
            observations=transitions.observations[row],
            actions=transitions.actions[row],
            rewards=transitions.rewards[row],
            terminations=transitions.terminations[row],
            truncations=transitions.truncations[row],
        )
