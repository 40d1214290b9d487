"""Command `portrait`: write a page about environments."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from study.commands.command import Argument, Command, Flag, StudyOptions
from study.commands.terminal import Bar, console
from study.common.errors import BadInput
from study.common.files import why_not_writable

DETAILS = """\
The page has pictures of the system, its variables with units, its noise, and the uncertainty of its
scenarios.

examples
  python -m study.run portrait pusher
  python -m study.run portrait uav --to pages"""


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `portrait`.

    Attributes:
        environment: registered name; None for all environments of the grid.
        to: folder of the page; None for OUT/environments.
    """

    environment: Annotated[str | None, Argument("such as pusher; all of the grid by default")] = (
        None
    )
    to: Annotated[Path | None, Flag("folder of the page; OUT/environments by default")] = None


def run(options: Options) -> int:
    """Write the page, and print the paths of its files."""
    from study.envs import simulators
    from study.envs.card.page import write_page

    environments = options.config.grid.environments
    names = [options.environment] if options.environment else list(environments)
    for name in names:
        simulators[name]
    folder = options.to or options.out / "environments"
    if problem := why_not_writable(folder):
        raise BadInput(f"{'--to' if options.to else '--out'}: {problem}")
    with Bar(console()) as bar:
        written = write_page(options.config.collect, names, folder, bar)
    print(*written, sep="\n")
    return 0


COMMAND = Command(
    "portrait",
    "write a page with pictures of an environment and of the uncertainty of its scenarios",
    Options,
    run,
    DETAILS,
)
