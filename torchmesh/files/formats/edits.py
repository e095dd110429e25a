"""Files that are changed in place: other bytes in some places, and all the rest to the letter."""

from collections.abc import Iterable

# Where it begins and ends in the file, and what comes in its place.
Edit = tuple[int, int, bytes]


def edited(data: bytes, edits: Iterable[Edit]) -> bytes:
    """The `data` with other bytes in some places.

    An edit inside of a longer one is left out: what it would change is gone.
    """
    out, at = [], 0
    for begin, end, new in sorted(edits, key=lambda edit: (edit[0], edit[0] != edit[1], -edit[1])):
        if begin < at:
            continue
        out += [data[at:begin], new]
        at = end
    return b"".join([*out, data[at:]])
