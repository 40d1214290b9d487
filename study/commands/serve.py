"""Command `serve`: the page and the recordings of a study in a browser on this machine."""

from study.commands.command import Command, ServerOptions
from study.commands.terminal import console, say

DETAILS = """\
Serves the page of a results folder, and Rerun's viewer for its recordings. A link to a recording on
the page opens it in the browser. Only this machine can connect, at the address that is printed.
Nothing is written. Ctrl-C ends it.

examples
  python -m study.run serve
  python -m study.run serve --out results/paper"""


def run(options: ServerOptions) -> int:
    """Serve until the user interrupts.

    Raises:
        BadInput: the folder has no results, or the port is in use.
    """
    from study.page.evidence import check_folder
    from study.page.server import Server

    check_folder(options.out)
    with Server(options.out, options.port) as server:
        say(console(), f"{options.out}: {server.address} (Ctrl-C ends it)")
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            return 0
    return 0


COMMAND = Command(
    "serve",
    "the page and the recordings in a browser on this machine",
    ServerOptions,
    run,
    DETAILS,
)
