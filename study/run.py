"""The command line: ``python -m study.run COMMAND``. Each command is a file of `study.commands`.

torch, lightning, mujoco and matplotlib take seconds to import, so a command imports them inside its
functions. They are imported after `isolate`, since an import reads environment variables.
"""

import os
import signal
import sys
from types import FrameType

from study.common.errors import StudyError, explain
from study.common.isolation import isolate

INTERRUPTED = 130
"""Exit code after Ctrl-C: 128 + SIGINT, as in shells."""
TERMINATED = 143
"""Exit code after SIGTERM: 128 + SIGTERM, as in shells."""
CLOSED_PIPE = 141
"""Exit code when the reader of a pipe has ended: 128 + SIGPIPE, as in shells."""
STOPPED = "stopped: run the same command again to go on from here"
OWN_PACKAGES = ("study", "paper_figs")
"""Packages of this repository. A missing module of theirs is a defect."""


def main(arguments: list[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: the command line without the name of the program; None for that of the process.

    Returns:
        the exit code: 0 all is well, 1 something failed, 2 the input is wrong, 130 interrupted,
        141 the reader of a pipe, such as `head`, has ended. After SIGTERM it is 143.
    """
    try:
        isolate()
        return _run(sys.argv[1:] if arguments is None else arguments)
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except BrokenPipeError:
        return _close_output()
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] in OWN_PACKAGES:
            raise
        print(
            f"error: {sys.executable} lacks the package '{error.name}'; "
            "run `source .venv/bin/activate`, or `make study` if there is no .venv",
            file=sys.stderr,
        )
        return 1
    except OSError as error:
        print(f"error: {explain(error)}; complete files are kept", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(STOPPED, file=sys.stderr)
        return INTERRUPTED
    except SystemExit as end:
        if end.code == TERMINATED:
            print(STOPPED, file=sys.stderr)
        raise


def _run(arguments: list[str]) -> int:
    from study.commands.parser import parse

    try:
        command, options = parse(arguments)
        code: int = command.run(options)
        return code
    finally:
        sys.stdout.flush()  # on exit, Python would report a closed pipe


def _close_output() -> int:
    """Replace standard output by the null device, since Python flushes it on exit and would fail.

    Returns:
        the exit code.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return CLOSED_PIPE


def _terminate(number: int, frame: FrameType | None) -> None:
    """End like after an error, so that temporary folders are removed and locks are released."""
    raise SystemExit(TERMINATED)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, _terminate)
    sys.exit(main())
