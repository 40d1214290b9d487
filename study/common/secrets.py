"""Passwords in URLs, which no output and no file may have."""

import re

HIDDEN = "***"
USER = re.compile(r"(?<=://)([^:\s@]*):\S*(?=@)")
PARAMETER = re.compile(r"(password=)[^&\s]+", re.IGNORECASE)


def without_passwords(text: str) -> str:
    """The text, with ``***`` for each password of a URL.

    >>> without_passwords("--tune.storage postgresql://me:secret@host/study?sslpassword=more")
    '--tune.storage postgresql://me:***@host/study?sslpassword=***'
    """
    return USER.sub(rf"\1:{HIDDEN}", PARAMETER.sub(rf"\1{HIDDEN}", text))
