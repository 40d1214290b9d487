"""A PostgreSQL server in a temporary folder, with a socket there and no port."""

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PASSWORD = "no%2Fone_reads_this"
"""As a URL has it."""
PLACES = sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
"""Debian's programs, which are not in ``PATH``; the newest first."""


def programs() -> Path | None:
    """The folder of PostgreSQL's programs; None where they are missing."""
    found = shutil.which("initdb")
    return Path(found).parent if found else next(iter(PLACES), None)


@contextmanager
def postgres() -> Iterator[str]:
    """Start a server.

    Yields:
        the URL of an empty database, with a password.
    """
    folder = Path(tempfile.mkdtemp(prefix="postgres-", dir="/tmp"))  # a socket's path is short
    data, password = folder / "data", folder / "password"
    password.write_text(PASSWORD.replace("%2F", "/"), encoding="utf-8")
    if os.geteuid() == 0:  # PostgreSQL refuses to run as root
        user = pwd.getpwnam("postgres")
        for path in (folder, password):
            os.chown(path, user.pw_uid, user.pw_gid)
    try:
        _run("initdb", "-D", data, "-U", "me", "-A", "scram-sha-256", f"--pwfile={password}", "-N")
        options = f"-k {folder} -c listen_addresses= -c fsync=off"
        _run("pg_ctl", "-D", data, "-w", "-l", folder / "log", "-o", options, "start")
        yield f"postgresql://me:{PASSWORD}@/postgres?host={folder}"
    finally:
        if (data / "postmaster.pid").exists():
            _run("pg_ctl", "-D", data, "-m", "immediate", "stop")
        shutil.rmtree(folder)


def _run(program: str, *arguments: object) -> None:
    folder = programs()
    assert folder is not None
    user = {"user": "postgres", "group": "postgres"} if os.geteuid() == 0 else {}
    subprocess.run(
        [folder / program, *map(str, arguments)],
        check=True,
        cwd="/",
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        **user,  # type: ignore[call-overload]
    )
