"""Errors for the user: one line that says what is wrong and what to do, never a traceback."""

import errno
from collections.abc import Iterable
from difflib import get_close_matches


class StudyError(Exception):
    """Something went wrong that the user can act on. The command line exits with `exit_code`."""

    exit_code = 1

    def __str__(self) -> str:
        return printable(super().__str__())


class BadInput(StudyError):
    """What the user gave cannot be used; nothing has been written. Exit code 2."""

    exit_code = 2


LISTED = 30
"""Names that an error lists, at most."""


def printable(text: str) -> str:
    """The text in one line, with a question mark for each character that cannot be shown."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def nearest(given: str, allowed: Iterable[str]) -> str:
    """The clause that ends an error about a name: the nearest valid one, and all that are allowed.

    >>> nearest("pushr", ["pusher", "uav"])
    "did you mean 'pusher'? (allowed: pusher, uav)"
    >>> nearest("drone", ["pusher", "uav"])
    'give one of pusher, uav'
    """
    names = list(allowed)
    matches = get_close_matches(given, names, n=1, cutoff=0.5)
    more = f", … {len(names)} in all" * (len(names) > LISTED)
    listed = f"{', '.join(names[:LISTED])}{more}"
    if matches:
        return f"did you mean '{matches[0]}'? (allowed: {listed})"
    return f"give one of {listed}" if names else "there is none"


REMEDIES = {
    errno.ENOSPC: "the disk is full; remove files from it or give another --out",
    errno.EDQUOT: "the disk quota is used up; remove files or give another --out",
    errno.EFBIG: "the size of files is limited (see `ulimit -f`); raise the limit",
    errno.EACCES: "no permission; change the permissions or give another --out",
    errno.EPERM: "no permission; change the permissions or give another --out",
    errno.EROFS: "the file system is read-only; give another --out",
    errno.ENAMETOOLONG: "the name is too long; give a shorter one",
}


def explain(error: OSError) -> str:
    """One line about an error of the operating system: the file, what is wrong, what to do.

    >>> explain(OSError(errno.ENAMETOOLONG, "File name too long", "x.md"))
    'x.md: the name is too long; give a shorter one'
    """
    reason = REMEDIES.get(error.errno or 0) or error.strerror or str(error)
    return reason if error.filename is None else f"{error.filename}: {reason}"


def shown(value: object) -> str:
    """A value that somebody gave, for an error: short, in one line, text in quotes.

    >>> shown("a\\nb"), shown(None), shown([1, 2])
    ("'a?b'", 'null', '[1, 2]')
    """
    if isinstance(value, dict):
        return "a section of settings"
    if isinstance(value, list):
        return _short(f"[{', '.join(map(str, value[:20]))}]")
    if isinstance(value, str):
        return f"'{_short(value)}'"
    return {"None": "null", "True": "true", "False": "false"}.get(str(value), _short(str(value)))


def _short(text: str, longest: int = 60) -> str:
    line = printable(text[: 2 * longest])
    return line if len(line) <= longest else f"{line[:longest]}…"
