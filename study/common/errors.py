"""Errors that are meant for the user: one line that says what to do, never a traceback."""

from collections.abc import Iterable
from difflib import get_close_matches


class StudyError(Exception):
    """Something went wrong that the user can act on. The command line exits with `exit_code`."""

    exit_code = 1


class BadInput(StudyError):
    """What the user gave cannot be used; nothing has been written. Exit code 2."""

    exit_code = 2


def nearest(given: str, allowed: Iterable[str]) -> str:
    """The clause that ends an error about a name: the nearest valid one, and all that are allowed.

    >>> nearest("pushr", ["pusher", "uav"])
    "did you mean 'pusher'? (allowed: pusher, uav)"
    """
    names = list(allowed)
    matches = get_close_matches(given, names, n=1, cutoff=0.5)
    listed = f"(allowed: {', '.join(names)})"
    return f"did you mean '{matches[0]}'? {listed}" if matches else listed
