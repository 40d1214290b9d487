"""Command `export`: write the training trajectories of an environment as a Minari data set."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from study.commands.command import Argument, Command, Flag, StudyOptions
from study.commands.terminal import Bar, console

DETAILS = """\
Needs Minari: pip install -e '.[minari]'.

examples
  python -m study.run export pusher
  python -m study.run export uav --collect.trajectories 100 --name small --to data"""


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `export`.

    Attributes:
        environment: registered name.
        to: folder of Minari data sets; None for Minari's default.
    """

    environment: Annotated[str, Argument("such as pusher")]
    to: Annotated[Path | None, Flag("folder of Minari data sets; by default that of Minari")] = None


def run(options: Options) -> int:
    """Simulate the trajectories, and write them."""
    from study.envs.minari_export import prepare

    export = prepare(options.config, options.environment, options.to)
    count = options.config.collect.trajectories
    print(f"simulating {count} trajectories, to be written to {export.data_set.folder}", flush=True)
    with Bar(console()) as bar:
        export.write(bar)
    variable = f", with MINARI_DATASETS_PATH={export.data_set.root}" if options.to else ""
    print(f'minari.load_dataset("{export.data_set.id}") loads them{variable}')
    return 0


COMMAND = Command(
    "export", "write training data as a Minari data set: export pusher", Options, run, DETAILS
)
