"""Counts in sentences."""


def counted(count: int, noun: str) -> str:
    """A count and its noun, in the plural unless the count is 1.

    >>> counted(1, "log"), counted(2, "trajectory"), counted(3000, "row")
    ('1 log', '2 trajectories', '3000 rows')
    """
    if count == 1:
        return f"{count} {noun}"
    return f"{count} {noun[:-1]}ies" if noun.endswith("y") else f"{count} {noun}s"
